"""People as sensors see them: skeletons of key points, what is known of a body by them, and where it may soon be."""
