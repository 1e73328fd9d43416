"""Anything that holds records, seen the same way: a run, a file of an oscilloscope, a memory card, a data set."""

from station.sources.batches import ExcludedRecord, Source
from station.sources.find import find_sources, open_source
