"""Sets of cells that chains hardly leave."""
