"""What analysing saved records again costs."""
