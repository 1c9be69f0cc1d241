"""Branch and prune, and the tightening of what it keeps."""
