"""At which share of a limit (tension, temperature) a person is warned, wherever it is shown."""

WARM = 0.6
HOT = 0.85
