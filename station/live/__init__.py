"""What happens while something is measured: events, status, preview, display."""
