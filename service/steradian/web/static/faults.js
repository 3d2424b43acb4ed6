// @ts-check
// Faults of the scanners: name, remedy and a dialog to clear them.
import { api } from "./api.js";
import { byId, h, replaceKeepingFocus } from "./dom.js";
import { pollScanners, lastStatus, onScanners } from "./scanner_status.js";
import { sentence } from "./units.js";
import { openReasonDialog } from "./reason_dialog.js";

let shownKey = "";

export function startFaults() {
  onScanners((_, all) => show(all));
}

/** @param {any[]} all */
function show(all) {
  if (lastStatus().failure) return; // keep the remedies readable while the status is unknown
  const faults = all.filter(({ fault }) => fault);
  const text = JSON.stringify(faults.map(({ id, fault }) => [id, fault.code, fault.title, fault.remedy]));
  if (text === shownKey) return;
  shownKey = text;
  const host = byId("faults");
  host.hidden = !faults.length;
  replaceKeepingFocus(host, ...faults.map((one) => faultElement(one, all.length > 1)));
}

/** @param {any} scanner @param {boolean} named */
function faultElement({ id, fault }, named) {
  return h("p", null,
    h("strong", null, `${named ? `${id}: ` : ""}${sentence(fault.title)}`), " ",
    h("span", null, sentence(fault.remedy)), " ",
    h("button", { type: "button", "aria-label": named ? `Clear the fault of ${id}` : "Clear the fault …", onclick: () => openClearDialog(id, fault) }, "Clear the fault …"));
}

/** Open the dialog that clears a fault; show the reason if the service refuses. @param {string} id @param {any} fault */
function openClearDialog(id, fault) {
  openReasonDialog({
    title: `Clear the fault: ${fault.title}`,
    text: `${sentence(fault.remedy)} The laser does not fire automatically afterwards: resume an interrupted scan on its page.`,
    label: "Action taken",
    name: "Clear the fault",
    act: async (reason) => {
      try {
        await api.post(`/scanners/${encodeURIComponent(id)}/clear-fault`, { reason });
        return "";
      } catch (error) {
        return error instanceof Error ? error.message : String(error);
      } finally {
        void pollScanners();
      }
    },
  });
}
