"""The commands of `jaxcell sweep`."""
