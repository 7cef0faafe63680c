"""The paper's control laws."""

from baselines.classical.feedback_linearization import FL, FeedbackLinearization

__all__ = ["FL", "FeedbackLinearization"]
