"""What became of all units that were tested, and whether the bench is what it was."""
