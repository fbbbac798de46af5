"""The contract of all drivers, in simulated time: `test_contract` tries packages of a lab's own, as commands."""

from lab.driver_contract import *  # noqa: F403
