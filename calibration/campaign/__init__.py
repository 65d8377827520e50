"""Many concealed cases, diagnosed blind and scored."""

from calibration.campaign.cases import Case, draw_cases
from calibration.campaign.run import run_case
from calibration.campaign.score import score_table

__all__ = ["Case", "draw_cases", "run_case", "score_table"]
