"""[federation]: this station among others, over a hub that all of them reach."""
