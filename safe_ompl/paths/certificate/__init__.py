"""Certificates of paths: what they hold, how they are issued, and how independent code verifies them."""
