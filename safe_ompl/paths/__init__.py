"""What happens to a path once it exists: report and certificate."""
