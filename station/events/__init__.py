"""What happens, as events: every display, file and other program only reads them."""
