"""What is measured with the controller, each by a command of its own."""
