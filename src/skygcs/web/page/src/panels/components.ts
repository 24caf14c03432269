// The components of the panels, by their names in `PANELS`: one module, which is loaded when a panel is first shown. Cut into
// one for each panel and those that some share, they were a seventh larger.

export { default as replay } from "./replay_panel.tsx";
export { default as vehicle } from "./vehicle_panel.tsx";
export { default as mission } from "./mission_panel.tsx";
export { default as plan } from "./plan_panel.tsx";
export { default as preflight } from "./fleet_preflight.tsx";
export { default as radio } from "./radio_panel.tsx";
export { default as recordings } from "./recordings_panel.tsx";
export { default as events } from "./events_panel.tsx";
