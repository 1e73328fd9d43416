"""Saved records analysed anew by the million: tables of results, and what two of them differ by."""
