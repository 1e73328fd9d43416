"""Who has an instrument: a program keeps others of its computer from the link that it uses, and says who it is."""

from instrument.in_use.claims import Claim, Holder, claim

__all__ = ["Claim", "Holder", "claim"]
