"""The search for the parameters of controllers, on equal budgets."""
