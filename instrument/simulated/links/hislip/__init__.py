"""HiSLIP after IVI-6.1: messages with their ends, device clear, status and locks over two TCP connections."""
