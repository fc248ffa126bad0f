"""The smallest machine with the outputs of a filter or a policy, and the proof."""
