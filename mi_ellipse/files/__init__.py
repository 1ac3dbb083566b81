"""Files that are replaced whole, locked folders, and pictures."""
