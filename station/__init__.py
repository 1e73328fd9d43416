"""Where instruments and analysis meet: what people run."""
