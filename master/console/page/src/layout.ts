// The layout of graphs, loaded by the first page with one.
export {default} from "@dagrejs/dagre";
