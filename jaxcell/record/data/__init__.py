"""Datasets and summaries that follow from what a result says of its quantities."""
