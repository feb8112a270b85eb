"""Where FMUs come from: models by name (`catalogue`), and building those that are stale (`build`, `stamps`)."""
