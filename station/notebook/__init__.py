"""What `import gyrolock` shows: runs, records and results as objects of a script or a notebook."""
