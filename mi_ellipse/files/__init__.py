"""Files that are replaced whole, and pictures in them."""
