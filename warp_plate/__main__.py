"""`python -m warp_plate` is the command `warp-plate`."""

from warp_plate.cli.main import main

main()
