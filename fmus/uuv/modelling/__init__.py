"""How a model is written down, and how its declaration becomes numbers in a row; the physics is beside this package."""
