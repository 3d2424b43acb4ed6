// @ts-check
// Redirect from the root URL to the running scan, the list of scans, or the design view.
import { api } from "./api.js";
import { byId } from "./dom.js";
import { showError, showLoading } from "./panel_states.js";
import { urlOf } from "./urls.js";

async function redirect() {
  const panel = byId("start");
  showLoading(panel, "looking for scans …");
  try {
    const running = (await api.get("/scans?state=running&limit=1")).items[0];
    const anyScan = running ?? (await api.get("/scans?limit=1")).items[0];
    location.replace(urlOf(running ? `/scans/${running.id}` : anyScan ? "/scans" : "/design"));
  } catch (error) {
    showError(panel, error, redirect);
  }
}

void redirect();
