"""Search for a provably smallest machine with the outputs of a filter or a policy."""
