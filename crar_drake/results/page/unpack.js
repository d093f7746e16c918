// Unpacks what crar_drake/results/packed_page.py has packed, and runs its scripts.

window.crarPacked = [];
(async () => {
  const element = document.getElementById("crar-packed");
  const bytes = Uint8Array.from(atob(element.textContent), c => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const all = await new Response(stream).arrayBuffer();
  let start = 0;
  const take = name => element.dataset[name].split(" ").filter(Boolean).map(length => {
    start += Number(length);
    return new Uint8Array(all.slice(start - length, start));
  });
  crarPacked.push(...take("parts"));
  for (const text of take("scripts")) {
    const script = document.createElement("script");
    script.textContent = new TextDecoder().decode(text);
    document.body.append(script); // runs at once
  }
  element.remove();
})().catch(error => {
  const stage = document.getElementById("crar-stage");
  stage.textContent = "This page could not be unpacked: it needs a browser of 2023 or "
    + `later (${error}).`;
  throw error;
});
