"""Commands about the instruments themselves: which are there, what one shows, a simulated one."""
