//! A process on a real terminal of 80 columns and 24 lines.

use std::fs::File;
use std::io::{Read, Write};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};

use nix::pty::{Winsize, openpty};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use super::eventually;

/// The other end of the terminal, with what the process wrote there. The process ends when this is
/// dropped.
#[derive(Debug)]
pub struct Terminal {
    child: Child,
    keyboard: File,
    written: Arc<Mutex<Vec<u8>>>,
    reader: Option<JoinHandle<()>>,
}

impl Terminal {
    /// Starts a command whose stdin, stdout and stderr are a terminal.
    pub fn start(command: &mut Command) -> Self {
        let size = Winsize { ws_row: 24, ws_col: 80, ws_xpixel: 0, ws_ypixel: 0 };
        let pair = openpty(&size, None).unwrap();
        let slave = || Stdio::from(pair.slave.try_clone().unwrap());
        command.env("TERM", "xterm").env_remove("CLICOLOR").env_remove("CLICOLOR_FORCE");
        let child = command.stdin(slave()).stdout(slave()).stderr(slave()).spawn().unwrap();
        // The command would keep these streams open, and with them the terminal.
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        let written: Arc<Mutex<Vec<u8>>> = Arc::default();
        let (shared, mut master) = (Arc::clone(&written), File::from(pair.master));
        let keyboard = master.try_clone().unwrap();
        let reader = thread::spawn(move || {
            let mut octets = [0; 4096];
            // The read fails as soon as no process can write to the terminal any more.
            while let Ok(length @ 1..) = master.read(&mut octets) {
                shared.lock().unwrap().extend(&octets[..length]);
            }
        });
        Self { child, keyboard, written, reader: Some(reader) }
    }

    /// Types a line and Enter, once the process has asked for it by a text that ends like this.
    pub fn answer(&mut self, question: &str, line: &str) {
        eventually(question, || self.text().ends_with(question).then_some(()));
        writeln!(self.keyboard, "{line}").unwrap();
    }

    /// Sends a signal to the process.
    pub fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.child.id() as i32), signal).unwrap();
    }

    /// Waits until the process has ended and returns its exit code. `None` when a signal killed it.
    pub fn end(&mut self) -> Option<i32> {
        let status = eventually("the process ends", || self.child.try_wait().unwrap());
        if let Some(reader) = self.reader.take() {
            reader.join().unwrap();
        }
        status.code()
    }

    /// All output so far.
    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.written.lock().unwrap()).into_owned()
    }

    /// Whether a text has colours, bold and the like: `ESC [ numbers m`.
    pub fn has_colours(text: &str) -> bool {
        text.split("\x1b[").skip(1).any(|sequence| {
            sequence.trim_start_matches(|c: char| c.is_ascii_digit() || c == ';').starts_with('m')
        })
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
