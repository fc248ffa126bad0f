"""Plans of a robot that chooses an angle at each bump: roadmap, routes, plans, and their files."""
