"""Runs on a rate table: windows of whole turns, their means, and what the means of one axis or of three say."""
