"""Anything that holds records, seen the same way: a run, a file of an oscilloscope, a memory card, a data set."""

from station.sources.batches import ExcludedRecord, RecordBatch, Source, batches_of
from station.sources.find import find_sources, open_source

__all__ = ["ExcludedRecord", "RecordBatch", "Source", "batches_of", "find_sources", "open_source"]
