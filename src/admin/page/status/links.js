// ── What is there for machines ──────────────────────────────────────────────────────────────────

const SHOWN_LENGTH = 200_000; // of a text; more would hold the browser up

/** A browser sends no token when it follows a link. So the page asks itself, and shows the answer. */
async function follow(event) {
  if (!sessionStorage.getItem(TOKEN)) return;
  event.preventDefault();
  const link = event.currentTarget;
  const viewer = $("viewer");
  write($("viewer-title"), `/${link.getAttribute("href")}`);
  write($("viewer-text"), "…");
  $("viewer-file").hidden = true;
  write($("viewer-note"), "");
  viewer.showModal();
  try {
    const answer = await request(link.getAttribute("href"));
    const file = await answer.blob();
    const text = await file.text();
    const isJson = answer.headers.get("content-type") === "application/json";
    const lines = isJson && text.length <= SHOWN_LENGTH ? JSON.stringify(JSON.parse(text), null, 2) : text;
    write($("viewer-text"), lines.slice(0, SHOWN_LENGTH));
    if (lines.length > SHOWN_LENGTH) write($("viewer-note"), "This is the beginning; the file has all of it.");
    URL.revokeObjectURL($("viewer-file").href);
    $("viewer-file").href = URL.createObjectURL(file);
    $("viewer-file").download = `pnet-nat-${link.textContent}`;
    $("viewer-file").hidden = !answer.ok;
  } catch (error) {
    write($("viewer-text"), error instanceof TokenNeeded ? "The token is not taken any more." : `No answer: ${error.message}`);
  }
}

for (const link of document.querySelectorAll("footer a")) {
  link.addEventListener("click", follow);
  link.addEventListener("auxclick", follow);
}
$("viewer-close").addEventListener("click", () => $("viewer").close());

