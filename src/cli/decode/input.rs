//! The input as a stream. Before each read all output is flushed, so whoever follows a capture sees each
//! datagram as it comes, and a long file costs few writes.

use std::cell::RefCell;
use std::fs::File;
use std::io::{self, Read, Write, stdin};
use std::os::fd::AsFd;
use std::path::Path;

use anyhow::Context;
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

use super::progress::Progress;
use super::stop::Stop;

/// Milliseconds between two looks at whether a signal has come.
const LOOK: u16 = 100;

/// A file, or what comes through a pipe.
pub(super) struct Input<'a, W> {
    file: File,
    output: &'a RefCell<W>,
    stop: Stop,
    progress: Progress,
}

/// Opens a file; `-` is the standard input. Returns it with its name for messages.
pub(super) fn open(path: &Path) -> anyhow::Result<(File, String)> {
    if path.as_os_str() == "-" {
        let name = "standard input".to_owned();
        let file = stdin().as_fd().try_clone_to_owned().with_context(|| name.clone())?;
        return Ok((file.into(), name));
    }
    let name = path.display().to_string();
    Ok((File::open(path).with_context(|| name.clone())?, name))
}

impl<'a, W: Write> Input<'a, W> {
    pub(super) fn new(file: File, output: &'a RefCell<W>, stop: Stop) -> Self {
        let length = file.metadata().ok().filter(|metadata| metadata.is_file());
        let progress = Progress::of(length.map(|metadata| metadata.len()));
        Self { file, output, stop, progress }
    }

    /// Waits until there is something to read. False when a signal came before.
    fn wait(&self) -> io::Result<bool> {
        while !self.stop.has_come() {
            let mut files = [PollFd::new(self.file.as_fd(), PollFlags::POLLIN)];
            match poll(&mut files, PollTimeout::from(LOOK)) {
                Ok(0) | Err(Errno::EINTR) => {}
                Ok(_) => return Ok(true),
                Err(error) => return Err(error.into()),
            }
        }
        Ok(false)
    }
}

impl<W: Write> Read for Input<'_, W> {
    /// After a signal, the input is at its end.
    fn read(&mut self, octets: &mut [u8]) -> io::Result<usize> {
        self.output.borrow_mut().flush()?;
        if !self.wait()? {
            return Ok(0);
        }
        let read = self.file.read(octets)?;
        self.progress.add(read);
        Ok(read)
    }
}
