"""From a snapshot to the problem: distances, rays, angles and chiralities of the points."""
