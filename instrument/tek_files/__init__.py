"""Waveform files of this family: the CSV that the scopes save themselves, ISF and answers kept by PC software."""

from instrument.tek_files.isf import parse_isf
from instrument.tek_files.reading import TekFile, read_tek_file, read_waveform
from instrument.tek_files.scope_csv import parse_csv
from instrument.tek_files.writing import csv_text

__all__ = [
    "TekFile",
    "csv_text",
    "parse_csv",
    "parse_isf",
    "read_tek_file",
    "read_waveform",
]
