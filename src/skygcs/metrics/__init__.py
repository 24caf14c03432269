"""Numbers for Prometheus: one metric, the text of many, and the HTTP address they are scraped at."""
