"use strict";
// Browsers start no Worker for a page that was opened as a file. There the script of the search runs in a hidden frame
// instead: what the page posts reaches the script, what the script posts reaches the page.
if (location.protocol === "file:") {
  // Within the frame, posting with a target origin is the page's call, posting without one the script's.
  const frameScript =
    "const post = window.postMessage.bind(window);" +
    "window.postMessage = (data, origin) => origin === undefined ? parent.postMessage(data, '*') : post(data, origin);";

  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.waiting = [];
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      this.frame.srcdoc = `<script>${frameScript}</script><script src="${encodeURI(decodeURI(String(url)))}"></script>`;
      this.frame.addEventListener("load", () => {
        for (const data of this.waiting.splice(0)) this.frame.contentWindow.postMessage(data, "*");
        this.waiting = null;
      });
      window.addEventListener("message", (event) => {
        if (event.source === this.frame.contentWindow)
          this.dispatchEvent(new MessageEvent("message", { data: event.data }));
      });
      const attach = () => document.body.append(this.frame);
      if (document.body) attach();
      else document.addEventListener("DOMContentLoaded", attach);
    }

    postMessage(data) {
      if (this.waiting) this.waiting.push(data);
      else this.frame.contentWindow.postMessage(data, "*");
    }

    terminate() {
      this.frame.remove();
    }
  };
}
