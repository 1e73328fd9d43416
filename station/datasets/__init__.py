"""Records of many sources in one file that other programs read: written, and read back as the same sources."""
