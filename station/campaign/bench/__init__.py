"""The bench of a campaign: looked at before, kept from other programs, brought to the conditions of each step."""
