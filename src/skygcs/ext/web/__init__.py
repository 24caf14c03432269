"""[web]: the process of the web page, kept running beside the daemon. The page itself is the room `web`."""
