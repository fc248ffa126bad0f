"""Datasets and summaries of results, from the descriptions of their quantities."""
