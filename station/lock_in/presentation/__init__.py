"""The result of a ring laser run as JSON, sentences, tables and plots."""
