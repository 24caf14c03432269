// Which keys mean STOP, and where letters are text.

type Key = Pick<KeyboardEvent, "key" | "shiftKey" | "ctrlKey" | "metaKey" | "altKey" | "repeat">;

/** True for Shift+S outside of text fields, and for F8 everywhere. */
export function isStopKey(event: Key, inText: boolean): boolean {
  if (event.repeat || event.ctrlKey || event.metaKey || event.altKey) return false;
  return event.key === "F8" || (event.shiftKey && event.key.toLowerCase() === "s" && !inText);
}

export function isTextField(target: EventTarget | null): boolean {
  if (!(target instanceof HTMLElement)) return false;
  if (target instanceof HTMLInputElement) return !["button", "checkbox", "radio", "range"].includes(target.type);
  return target instanceof HTMLTextAreaElement || target instanceof HTMLSelectElement || target.isContentEditable;
}

/** Whether a person presses this letter alone, outside of text fields, for a button that is on the screen. */
export function isLetterFor(event: KeyboardEvent, letter: string | undefined, button: Element | null): boolean {
  if (event.key.toLowerCase() !== letter || event.repeat || !event.isTrusted || isTextField(event.target)) return false;
  return !(event.ctrlKey || event.metaKey || event.altKey || event.shiftKey) && isSeen(button);
}

/** Whether a person can see it: letters are orders only while their buttons, with their targets, are on the screen. */
function isSeen(element: Element | null): boolean {
  return element !== null && element.getClientRects().length > 0 && document.querySelector("dialog[open]") === null;
}
