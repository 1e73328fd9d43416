"""`gyrolock panel`: measurements in a browser, which reads events and presses the buttons of the command line."""
