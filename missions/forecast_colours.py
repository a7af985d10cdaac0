"""The colours of the forecast's verdicts, the same in pictures and reports."""

from soil_flow_estimator.soil_state import ForecastVerdict

FORECAST_COLOURS = {
    ForecastVerdict.NONE: "#d9d9d9",
    ForecastVerdict.CLEAR: "#bfe3c0",
    ForecastVerdict.CAUTION: "#ffe49c",
    ForecastVerdict.STOP: "#e06666",
    ForecastVerdict.SLIPPING: "#f4a582",
    ForecastVerdict.SNAG: "#d4b9da",
}
