"""Numbers for Prometheus: what they are called, how they are collected, and the HTTP address they are scraped at."""
