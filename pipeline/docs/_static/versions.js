/* Version selector. Sites of several versions are folders side by side, and `versions.js` above them lists them. This
   file is a script, not JSON, because browsers load no JSON for pages that are opened as files. */
document.addEventListener("DOMContentLoaded", () => {
  const root = document.documentElement.dataset.content_root || "./";
  const list = document.createElement("script");
  list.src = `${root}../versions.js`;
  list.onload = () => {
    for (const label of document.querySelectorAll("label.versions")) {
      const select = label.querySelector("select");
      const current = select.dataset.current;
      for (const version of window.MAGLINE_VERSIONS) {
        select.add(new Option(version, version, version === current, version === current));
      }
      select.onchange = () => { location.href = `${root}../${select.value}/index.html`; };
      label.hidden = false;
    }
  };
  document.head.append(list);
});
