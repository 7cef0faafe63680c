"""Gymnasium environments and a payload benchmark for cable-suspended robots."""
