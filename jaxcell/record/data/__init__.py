"""Datasets and summaries of results, labelled with the descriptions of their quantities."""
