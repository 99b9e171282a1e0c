"""Latency from a fracture to the page, and the page's frame rate."""
