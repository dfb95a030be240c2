// Plots of time series, loaded when the first figures are painted.
export {default} from "uplot";
