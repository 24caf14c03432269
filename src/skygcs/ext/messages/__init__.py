"""Any message of the dialect, sent for a client: made when `messages.send` is first called."""
