"""The decision: which angular velocity each wheel gets, and when to stop, wait, try again or give up."""
