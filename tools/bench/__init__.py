"""Speed of the parts and of the whole, each beside a peer of the same run."""
