"""Learned policies: what trains them."""
