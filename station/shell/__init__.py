"""What every command shares: its options, its ending."""
