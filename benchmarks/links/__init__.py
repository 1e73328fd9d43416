"""Links with latency and faults, and a scope that remembers what it sent over them."""
