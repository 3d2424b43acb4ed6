// @ts-check
// Where the bare address leads: to the scan that runs, to the scans there are, or to the first step.
import { api } from "./api.js";
import { byId } from "./dom.js";
import { failed, loading } from "./panel_states.js";
import { at } from "./urls.js";

async function lead() {
  const panel = byId("start");
  loading(panel, "looking what there is …");
  try {
    const running = (await api.get("/scans?state=running&limit=1")).items[0];
    const any = running ?? (await api.get("/scans?limit=1")).items[0];
    location.replace(at(running ? `/scans/${running.id}` : any ? "/scans" : "/design"));
  } catch (error) {
    failed(panel, error, lead);
  }
}

void lead();
