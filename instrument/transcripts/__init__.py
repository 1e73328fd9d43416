"""What a program and an instrument said to each other, as readable lines: written down, and served again."""
