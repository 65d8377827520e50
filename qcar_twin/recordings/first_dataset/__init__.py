"""A first dataset.toml from logs: what the columns seem to be, with the reason for every guess."""

from qcar_twin.recordings.first_dataset.propose import Proposal, propose

__all__ = ["Proposal", "propose"]
