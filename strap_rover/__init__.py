"""The ground every package stands on: soil laws, rover description, topic contract, node shell, recorder."""

__version__ = "0.1.0"
