// How numbers and times are written.

export function count(number: number): string {
  if (!Number.isFinite(number)) return "-";
  if (number >= 1e9) return `${(number / 1e9).toFixed(1)} G`;
  if (number >= 1e6) return `${(number / 1e6).toFixed(1)} M`;
  if (number >= 1e4) return `${(number / 1e3).toFixed(1)} k`;
  return number >= 100 || Number.isInteger(number) ? Math.round(number).toString() : number.toFixed(1);
}

export function bytes(number: number): string {
  if (number >= 1 << 20) return `${(number / (1 << 20)).toFixed(1)} MB`;
  if (number >= 1 << 10) return `${(number / (1 << 10)).toFixed(1)} KB`;
  return `${Math.round(number)} B`;
}

export function duration(us: number): string {
  if (us < 1) return `${us.toFixed(2)} µs`;
  if (us < 1000) return `${us < 10 ? us.toFixed(1) : Math.round(us)} µs`;
  if (us < 1e6) return `${us < 1e4 ? (us / 1000).toFixed(1) : Math.round(us / 1000)} ms`;
  return us < 1e8 ? `${(us / 1e6).toFixed(1)} s` : `${Math.round(us / 6e7)} min`;
}

export function age(since_ms: number, now = Date.now()): string {
  if (!since_ms) return "-";
  const s = Math.max(0, Math.round((now - since_ms) / 1000));
  if (s < 60) return `${s} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min`;
  if (s < 86_400) return `${Math.floor(s / 3600)} h ${Math.floor((s % 3600) / 60)} min`;
  return `${Math.floor(s / 86_400)} d`;
}

export function time(ms: number): string {
  return new Date(ms).toISOString().replace("T", " ").replace(/\.\d+Z$/, "");
}

export const plural = (number: number, word: string): string => `${number} ${word}${number === 1 ? "" : "s"}`;

/** A short id for people: ids of instances are 32 digits. */
export const short = (id: string): string => (id.length > 12 ? id.slice(0, 8) : id);

/** CSV, of which no cell becomes a formula in a table program. */
export function csv(columns: string[], rows: Record<string, unknown>[]): string {
  const cell = (value: unknown): string => {
    let text = value === undefined || value === null ? "" : typeof value === "object" ? JSON.stringify(value) : String(value);
    if (/^[=+\-@\t\r]/.test(text)) text = `'${text}`;
    return /[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  return [columns, ...rows.map((row) => columns.map((column) => row[column]))]
    .map((line) => line.map(cell).join(",")).join("\r\n") + "\r\n";
}

export function save(name: string, type: string, text: string): void {
  const url = URL.createObjectURL(new Blob([text], {type}));
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  link.click();
  window.setTimeout(() => URL.revokeObjectURL(url), 10_000);
}
