"""What a result consists of, whatever was measured."""
