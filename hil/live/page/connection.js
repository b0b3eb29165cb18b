"use strict";
// The connection to the server: it is opened again after a loss, and it knows how old the data are.

const RETRY_MS = 500, MAX_RETRY_MS = 10000;  // time to the next attempt: twice as long after each
const OPEN_TIMEOUT_MS = 5000;  // a server that is suspended takes connections and never answers
const SILENT_MS = 10000;  // an open connection without a message for this long is dead: the server sends 30 a second
const STALE_MS = 2000;  // data of this age are not shown as the present
const STOP_ANSWER_MS = 2000, ANSWER_MS = 10000;  // a request that has no answer after this time is reported

// `on`: functions messages(list), rows(Float64Array), changed(), unanswered(id and name of a request, text).
class Connection {
  constructor(on) {
    this.on = on;
    this.isOpen = this.isOver = false;
    this.data_ms = null;  // time of day of the last data, from the age that the server gives
    this.beat_s = null;  // time of the server's own clock in its last message
    this.isBehind = false;  // more of the past is on its way
    this.feedError = "";  // why the next run of a daemon cannot be shown
    this.refused = 0;  // HTTP status with which the server refuses this page
    this.retry_ms = RETRY_MS;
    this.waiting = new Map();  // requests without an answer: name and time
    this.lastId = 0;
    setInterval(() => this.check(), 250);
    for (const name of ["online", "pageshow"]) window.addEventListener(name, () => this.retry());
    document.addEventListener("visibilitychange", () => { if (!document.hidden) this.retry(); });
    this.open();
  }
  get isStale() { return !this.isOver && (!this.isOpen || this.age_ms > STALE_MS); }
  // Age of the last data, or without data the time since the connection was opened or the run began. The clock of the
  // day goes on while a machine is suspended.
  get age_ms() { return Math.max(Date.now() - (this.data_ms ?? this.opened_ms ?? 0), 0); }

  open() {
    const socket = this.socket = new WebSocket(`ws://${location.host}/stream${location.search}`);
    const timer = setTimeout(() => socket.close(), OPEN_TIMEOUT_MS);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      clearTimeout(timer);
      this.isOpen = true;
      this.refused = 0;
      this.opened_ms = this.message_ms = Date.now();
      this.on.changed();
    };
    socket.onmessage = ({ data }) => {
      this.message_ms = Date.now();
      this.retry_ms = RETRY_MS;
      if (typeof data === "string") this.on.messages(JSON.parse(data));
      else this.on.rows(new Float64Array(data));
    };
    socket.onclose = () => {
      clearTimeout(timer);
      if (!this.isOpen) this.askWhy();
      this.lose();
    };
  }
  // Forget the connection, and open another one later.
  lose() {
    this.socket.onopen = this.socket.onmessage = this.socket.onclose = null;
    this.socket.close();
    this.isOpen = false;
    const lost = [...this.waiting];
    this.waiting.clear();
    for (const [id, { name }] of lost) this.on.unanswered(id, name, "the connection was lost before the answer");
    this.on.changed();
    this.timer = setTimeout(() => this.retry(), this.retry_ms);
    this.retry_ms = Math.min(2 * this.retry_ms, MAX_RETRY_MS);
  }
  retry() {
    if (!this.timer) return;
    clearTimeout(this.timer);
    this.timer = null;
    this.open();
  }
  // A browser does not say why a stream was refused; the same address as a page does.
  async askWhy() {
    try {
      const { status } = await fetch(`/stream${location.search}`, { cache: "no-store" });
      this.refused = status === 403 || status === 503 ? status : 0;
    } catch { this.refused = 0; }
    this.on.changed();
  }
  check() {
    const now_ms = Date.now();
    if (this.isOpen && now_ms - this.message_ms > SILENT_MS) this.lose();
    for (const [id, { name, at_ms }] of this.waiting) {
      const limit_ms = name === "stop" ? STOP_ANSWER_MS : ANSWER_MS;
      if (now_ms - at_ms < limit_ms) continue;
      this.waiting.delete(id);
      this.on.unanswered(id, name, `no answer for ${limit_ms / 1000} s`);
    }
    this.on.changed();
  }
  // Send a message. Return the id of a request, true for another message, or 0 without a connection.
  send(message) {
    if (!this.isOpen) return 0;
    if (message.request) {
      message = { ...message, id: this.lastId += 1 };
      this.waiting.set(this.lastId, { name: message.request, at_ms: Date.now() });
    }
    this.socket.send(JSON.stringify(message));
    return message.id || true;
  }
  answered(id) { this.waiting.delete(id); }
  // `age_s`: age of the last row that the page has or gets with this message, by the server's clock.
  tookBeat({ beat_s, age_s, is_behind }) {
    this.beat_s = beat_s;
    this.isBehind = is_behind;
    if (age_s !== null) this.data_ms = Date.now() - 1000 * age_s;
  }
  tookData() { this.data_ms = Date.now(); }
  // Another run has begun, of which no data have come.
  forgetData() {
    this.data_ms = null;
    this.opened_ms = Date.now();
    this.isBehind = false;
    this.feedError = "";
  }

  // What is wrong, in words; empty if nothing is.
  get trouble() {
    if (this.refused === 403) return "The token of this page is no longer right: the command that serves the page was restarted. Open the new address that it printed.";
    if (this.refused === 503) return "Too many pages are open. Close one; this page tries again.";
    if (this.isOver && this.isOpen && this.feedError) return this.feedError;
    if (this.isOver && (this.isOpen || !this.isAwaited)) return "";
    if (!this.isOpen) return "Connection lost, trying again. If the command that serves the page was restarted, open the new address that it printed.";
    if (!this.isStale) return "";
    if (Date.now() - this.message_ms > STALE_MS) return "The server does not answer.";
    return this.isBehind ? "" : "The loop sends no data.";
  }
  // How old the data are. It changes all the time, and is therefore not announced as the trouble is.
  get age() {
    if (!this.trouble) return "";
    if (!this.data_ms) return "No data have arrived yet.";
    const s = Math.max(Math.round((Date.now() - this.data_ms) / 1000), 0);
    const ago = s < 120 ? `${s} s` : s < 7200 ? `${Math.floor(s / 60)} min` : `${Math.floor(s / 3600)} h`;
    return `The last data are from ${new Date(this.data_ms).toLocaleTimeString()}, ${ago} ago.`;
  }
}
