// @ts-check
// Dialog that asks for the reason of an action and shows why the service refused it.
import { h, openDialog } from "./dom.js";

/**
 * @param {{title: string, text: string, label: string, name: string, act: (reason: string) => Promise<string>}} about
 *   `name` is the label of the button; `act` executes the action and returns the reason of a failure, or an empty string
 */
export function openReasonDialog({ title, text, label, name: action, act: submit }) {
  const reason = h("input", { type: "text", id: "why", required: true, maxlength: 500, style: { width: "100%" } });
  const errorText = h("p", { class: "fault", role: "alert" });
  const form = h("form", null,
    h("h2", { id: "why-title" }, title), h("p", null, text),
    h("label", { for: "why" }, label), reason, errorText,
    h("menu", null,
      h("button", { type: "button", onclick: () => dialog.close() }, "Cancel"),
      h("button", { class: "primary" }, action)));
  const dialog = h("dialog", { "aria-labelledby": "why-title" }, form);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    errorText.textContent = await submit(reason.value.trim());
    if (!errorText.textContent) dialog.close();
  });
  openDialog(dialog);
}
