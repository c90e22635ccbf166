"""The entry point of `python -m hjprofile`."""

from hjprofile.cli import main

if __name__ == "__main__":
    main()
