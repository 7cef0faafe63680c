"""Learned policies: what trains them, what they are, and those that ship."""
