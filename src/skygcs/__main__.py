"""`python -m skygcs` is `skygcs`."""

from skygcs.cli.serve import main

if __name__ == "__main__":
    main()
