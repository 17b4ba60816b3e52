//! A database on several machines, of which one takes writes and the others follow it: as libpq names them.

use std::time::Duration;

use futures::future::join_all;
use sqlx::postgres::{PgConnectOptions, PgConnection};
use sqlx::{ConnectOptions, Connection};

use crate::storage::StorageError;

/// A machine that takes longer to say what it is counts as away.
const ANSWER: Duration = Duration::from_secs(5);

/// What libpq has for machines of which one is wanted; a server wants the one that takes writes, whether told so or not.
const WANTED: &str = "target_session_attrs";
const WRITABLE: [&str; 2] = ["read-write", "primary"];

/// The machines of a database, in the order of its address.
#[derive(Clone, Debug)]
pub(super) struct Machines(Vec<Machine>);

#[derive(Clone, Debug)]
struct Machine {
    /// Host and port as they were given, for people.
    name: String,
    /// The address with this machine alone.
    address: String,
    options: PgConnectOptions,
}

/// What a machine says that it is.
#[derive(Debug)]
enum Found {
    /// It takes writes.
    Primary {
        connection: PgConnection,
        /// Grows with each machine that was made the primary: hexadecimal digits, always as many.
        timeline: String,
    },
    Standby,
    Away(String),
}

/// The machine that takes writes.
pub(super) struct Primary {
    pub(super) connection: PgConnection,
    /// The database's address with this machine alone.
    pub(super) address: String,
}

impl Machines {
    /// Those of `address`, a URL with one host and port or several between commas; what is wrong with it if it is none.
    pub(super) fn of(address: &str) -> Result<Self, String> {
        let (scheme, rest) = address.split_once("://").ok_or("it has no ://")?;
        let end = rest.find(['/', '?', '#']).unwrap_or(rest.len());
        let (authority, path) = rest.split_at(end);
        let path = without_wanted(path)?;
        let (user, hosts) = authority.rsplit_once('@').map_or(("", authority), |(user, hosts)| (user, hosts));
        let user = if user.is_empty() { String::new() } else { format!("{user}@") };
        let machine = |name: &str| {
            if name.is_empty() && hosts.contains(',') {
                return Err("a host between commas is empty".to_owned());
            }
            let address = format!("{scheme}://{user}{name}{path}");
            let options = address.parse::<PgConnectOptions>().map_err(|error| error.to_string())?;
            Ok(Machine { name: name.to_owned(), address, options })
        };
        hosts.split(',').map(machine).collect::<Result<_, _>>().map(Self)
    }

    /// Connects to the one that takes writes.
    ///
    /// # Errors
    /// [`StorageError::Unfit`] if none does, with what each said.
    pub(super) async fn primary(&self) -> Result<Primary, StorageError> {
        let asked = self.0.iter().map(async |machine| (machine, machine.ask().await));
        let mut primaries = Vec::new();
        let mut others = Vec::new();
        for (machine, found) in join_all(asked).await {
            match found {
                Found::Primary { connection, timeline } => primaries.push((timeline, machine, connection)),
                Found::Standby => others.push((machine, "is a standby, which takes no writes".to_owned())),
                Found::Away(why) => others.push((machine, why)),
            }
        }
        // One that was the primary before another, and that nobody stopped, knows less.
        primaries.sort_by(|(one, ..), (other, ..)| other.cmp(one));
        let mut primaries = primaries.into_iter();
        let Some((_, machine, connection)) = primaries.next() else { return Err(none_of(&others)) };
        for (_, other, connection) in primaries {
            tracing::error!(
                used = machine.name,
                older = other.name,
                "two machines of the database take writes; stop the older one before somebody writes to it"
            );
            connection.close().await?;
        }
        Ok(Primary { connection, address: machine.address.clone() })
    }
}

/// The rest of an address without what a server wants anyway; an error if something else is wanted.
fn without_wanted(path: &str) -> Result<String, String> {
    let Some((path, query)) = path.split_once('?') else { return Ok(path.to_owned()) };
    let mut kept = Vec::new();
    for setting in query.split('&') {
        match setting.split_once('=') {
            Some((WANTED, value)) if WRITABLE.contains(&value) => {}
            Some((WANTED, value)) => {
                return Err(format!(
                    "{WANTED} is {value}, and a server writes: make it read-write, or leave it out"
                ));
            }
            Some(_) | None => kept.push(setting),
        }
    }
    Ok(format!("{path}?{}", kept.join("&")))
}

fn none_of(others: &[(&Machine, String)]) -> StorageError {
    let [(_, why)] = others else {
        let each: Vec<String> =
            others.iter().map(|(machine, why)| format!("{} {why}", machine.name)).collect();
        return StorageError::Unfit(format!(
            "no machine of the database takes writes: {}; see that one is the primary, that the database exists there, \
             and that the user may use it",
            each.join("; ")
        ));
    };
    StorageError::Unfit(format!(
        "the database {why}; see that PostgreSQL runs there and is no standby, that the database exists, and that the user \
         may use it"
    ))
}

impl Machine {
    async fn ask(&self) -> Found {
        let asked = async {
            let mut connection = self.options.connect().await?;
            let standby: bool =
                sqlx::query_scalar("SELECT pg_is_in_recovery()").fetch_one(&mut connection).await?;
            if standby {
                return Ok(Found::Standby);
            }
            // The control file tells of a new timeline only after the next checkpoint; names of log files, at once.
            let timeline = sqlx::query_scalar("SELECT left(pg_walfile_name(pg_current_wal_lsn()), 8)");
            let timeline = timeline.fetch_one(&mut connection).await?;
            Ok::<_, sqlx::Error>(Found::Primary { connection, timeline })
        };
        match tokio::time::timeout(ANSWER, asked).await {
            Ok(Ok(found)) => found,
            Ok(Err(error)) => Found::Away(format!("cannot be used ({error})")),
            Err(_late) => Found::Away(format!("did not answer in {} s", ANSWER.as_secs())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn addresses(address: &str) -> Vec<String> {
        Machines::of(address).unwrap().0.into_iter().map(|machine| machine.address).collect()
    }

    #[test]
    fn each_machine_has_an_address_with_all_else() {
        assert_eq!(addresses("postgres:///maps"), ["postgres:///maps"]);
        assert_eq!(
            addresses("postgresql:///maps?host=/run/postgresql"),
            ["postgresql:///maps?host=/run/postgresql"]
        );
        assert_eq!(
            addresses("postgres://waypost:a,b@one:5433,two,[::1]:5434/maps?sslmode=require"),
            [
                "postgres://waypost:a,b@one:5433/maps?sslmode=require",
                "postgres://waypost:a,b@two/maps?sslmode=require",
                "postgres://waypost:a,b@[::1]:5434/maps?sslmode=require",
            ]
        );
    }

    #[test]
    fn what_a_server_wants_anyway_is_left_out() {
        for wanted in WRITABLE {
            let address = format!("postgres://one,two/maps?target_session_attrs={wanted}&sslmode=require");
            assert_eq!(
                addresses(&address),
                ["postgres://one/maps?sslmode=require", "postgres://two/maps?sslmode=require"]
            );
        }
    }

    #[test]
    fn what_is_no_address_is_refused() {
        for (address, says) in [
            ("maps", "no ://"),
            ("postgres://one,,two/maps", "between commas is empty"),
            ("postgres://one:notaport,two/maps", "port"),
            ("postgres://one/maps?target_session_attrs=standby", "make it read-write"),
        ] {
            let refused = Machines::of(address).unwrap_err();
            assert!(refused.contains(says), "{address}: {refused}");
        }
    }
}
