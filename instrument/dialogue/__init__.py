"""Bytes and questions in step with one instrument."""
