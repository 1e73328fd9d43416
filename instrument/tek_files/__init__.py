"""Waveform files of this family: the CSV that the scopes save themselves, ISF and answers kept by PC software."""

from instrument.tek_files.csv import csv_text, parse_csv
from instrument.tek_files.read import TekFile, parse_isf, read_tek_file, read_waveform

__all__ = ["TekFile", "csv_text", "parse_csv", "parse_isf", "read_tek_file", "read_waveform"]
