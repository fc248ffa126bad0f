"""The commands of `jaxcell robot`."""
