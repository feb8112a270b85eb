from .package import main

main()
