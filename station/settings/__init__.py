"""Settings in TOML files."""
