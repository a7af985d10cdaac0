"""The colours of the supervisor's modes, the same on paper and on the screen."""

from traction_controller.supervisor import TractionMode

MODE_COLOURS = {
    TractionMode.STANDBY: "#d9d9d9",
    TractionMode.DRIVE: "#bfe3c0",
    TractionMode.LIMIT: "#ffe49c",
    TractionMode.STALL: "#f4a582",
    TractionMode.WAIT: "#c6dbef",
    TractionMode.RETRY: "#d4b9da",
    TractionMode.HALT: "#e06666",
    TractionMode.FAULT: "#b2182b",
    TractionMode.FORECAST_STOP: "#f781bf",
    TractionMode.BACK_OUT: "#80cdc1",
}
