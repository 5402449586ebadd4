//! `[runtime] user`: the user that the relay becomes when root has started it.
//!
//! The change has to happen before there is a second thread, because the kernel changes only the
//! calling thread. This module reads `/etc/passwd` itself. The C library of a static program could
//! not load its modules for that.

use std::fs;

use nix::errno::Errno;
use nix::unistd::{Gid, Uid, geteuid, setegid, seteuid, setgroups, setresgid, setresuid};

const USERS: &str = "/etc/passwd";
const ROOT: Uid = Uid::from_raw(0);

/// A user of this host, with its own group and no others.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct User {
    /// The user as configured: a name or a number.
    name: String,
    uid: Uid,
    gid: Gid,
}

/// Why the process cannot become a user.
#[derive(Debug, thiserror::Error)]
pub enum UserError {
    /// There is no such user.
    #[error(
        "[runtime] user: there is no user {0:?} on this host; make one with `useradd --system`"
    )]
    Unknown(String),
    /// The user is root, so nothing would change.
    #[error("[runtime] user: root is what is to be given up; name a user of the relay's own")]
    Root,
    /// The process is not root, and only root can become another user.
    #[error("[runtime] user: only root becomes {0:?}; start the relay as root, or as that user")]
    NotRoot(String),
    /// The system refuses the change.
    #[error("[runtime] user: cannot become {user:?}: {source}")]
    Refused {
        /// The user as configured.
        user: String,
        /// The error that the system gave.
        source: Errno,
    },
}

impl User {
    /// Finds the user with this name or number. A number that belongs to no user is taken as a user
    /// ID, with the group of the same number.
    pub fn find(user: &str) -> Result<Self, UserError> {
        let users = fs::read_to_string(USERS).unwrap_or_default();
        let found = Self::find_among(&users, user);
        let found = found.ok_or_else(|| UserError::Unknown(user.to_owned()))?;
        if found.uid.is_root() { Err(UserError::Root) } else { Ok(found) }
    }

    fn new(name: &str, uid: u32, gid: u32) -> Self {
        Self { name: name.to_owned(), uid: Uid::from_raw(uid), gid: Gid::from_raw(gid) }
    }

    /// Finds a user in `users`, which has the format of passwd(5): `name:password:uid:gid:…`.
    fn find_among(users: &str, user: &str) -> Option<Self> {
        let number = user.parse::<u32>().ok();
        let entry = |line: &str| {
            let mut fields = line.split(':');
            let (name, uid) = (fields.next()?, fields.nth(1)?.parse().ok()?);
            let gid = fields.next()?.parse().ok()?;
            let is_it = number.map_or(name == user, |number| number == uid);
            is_it.then(|| Self::new(user, uid, gid))
        };
        let itself = number.map(|number| Self::new(user, number, number));
        users.lines().find_map(entry).or(itself)
    }

    /// Does something with the rights of this user only, and becomes root again. So a file that
    /// this user cannot read later is not read now either. Fails when the process is neither root
    /// nor this user.
    pub fn act<T>(&self, act: impl FnOnce() -> T) -> Result<T, UserError> {
        if !geteuid().is_root() {
            let not_root = UserError::NotRoot(self.name.clone());
            return if geteuid() == self.uid { Ok(act()) } else { Err(not_root) };
        }
        let refused = |source| UserError::Refused { user: self.name.clone(), source };
        setgroups(&[]).and_then(|()| setegid(self.gid)).map_err(refused)?;
        seteuid(self.uid).map_err(refused)?;
        let done = act();
        seteuid(ROOT).and_then(|()| setegid(Gid::from_raw(0))).map_err(refused)?;
        Ok(done)
    }

    /// Becomes this user for good. Does nothing when the process is this user already.
    pub fn become_for_good(&self) -> Result<(), UserError> {
        if !geteuid().is_root() {
            return Ok(());
        }
        setgroups(&[])
            .and_then(|()| setresgid(self.gid, self.gid, self.gid))
            .and_then(|()| setresuid(self.uid, self.uid, self.uid))
            .map_err(|source| UserError::Refused { user: self.name.clone(), source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PASSWD: &str = "root:x:0:0:root:/root:/bin/bash\n\
                          broken:x\n\
                          pnet:x:990:985::/nonexistent:/usr/sbin/nologin\n\
                          1234:x:7:8::/:/bin/false\n";

    #[test]
    fn a_user_is_found_by_name_or_number() {
        let found = |user| {
            let user = User::find_among(PASSWD, user)?;
            Some((user.uid.as_raw(), user.gid.as_raw()))
        };
        assert_eq!(found("pnet"), Some((990, 985)));
        assert_eq!(found("990"), Some((990, 985)));
        assert_eq!(found("65532"), Some((65_532, 65_532)));
        assert_eq!(found("1234"), Some((1234, 1234)), "a number is no name");
        for none in ["", "nobody-here", "broken", "-1", "x"] {
            assert_eq!(found(none), None, "{none:?}");
        }
        assert!(matches!(User::find("0"), Err(UserError::Root)));
    }
}
