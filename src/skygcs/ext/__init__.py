"""Extensions: each is one folder with its class, its keys, its methods; none imports another."""
