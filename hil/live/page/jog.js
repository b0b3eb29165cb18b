"use strict";
// A jog that lasts while a button is held: a short jog again and again, each after the answer to the one before.

const JOG_INTERVAL_MS = 100;  // the daemon centres the valve 0.2 s after a jog that no other follows

class HeldJog {
  // `send()` sends one jog and returns its id, or 0 without a connection.
  constructor(send) {
    this.send = send;
    this.isHeld = false;
    this.waitingId = this.timer = 0;
  }
  press() {
    if (this.isHeld) return;
    this.isHeld = true;
    if (!this.waitingId) this.next();
  }
  release() {
    this.isHeld = false;
    clearTimeout(this.timer);
    this.timer = 0;
  }
  next() {
    this.timer = 0;
    this.sent_ms = performance.now();
    this.waitingId = this.send();
    if (!this.waitingId) this.release();
  }
  answered(id) {
    if (id !== this.waitingId) return;
    this.waitingId = 0;
    const wait_ms = Math.max(JOG_INTERVAL_MS - (performance.now() - this.sent_ms), 0);
    if (this.isHeld) this.timer = setTimeout(() => this.next(), wait_ms);
  }
  // The jog with this id will get no answer: the button must be pressed again.
  unanswered(id) {
    if (id !== this.waitingId) return;
    this.waitingId = 0;
    this.release();
  }
}
