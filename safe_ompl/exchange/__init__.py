"""Results, paths and scenes as files: one versioned JSON form, CSV, and the shape of a JointTrajectory."""
