"""The driver of the TDS2014 and its family."""
