"""A campaign on the terminal and as JSON: what it will do, how it has ended."""
