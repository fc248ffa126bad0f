"""Search for the smallest machine with the outputs of a filter or a policy, with a proof."""
