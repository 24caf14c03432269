"""The keys of vehicles' message signing: given, taken away, and their clock set back."""
