//! A run: a real server, the model beside it, and one step after the other made to both.

use std::collections::{BTreeMap, HashMap};
use std::io::Cursor;
use std::time::Duration;

use waypost_client::{Client, v1};

use super::calls::{Answer, Call, Heard};
use super::comparison::{differences, expected, map_line, observed, told_map_line};
use super::now_ns;
use super::operations::{End, Kill, Operation, Step};
use super::plain::{World, token_name};
use super::sabotage::Sabotage;
use super::seen::model;
use super::serving::Server;
use crate::harness::{Built, ServerProcess, followed, run_to_its_end};
use crate::operations::disk::watched::{Calls, Fault, How, WatchedDisk};

/// Steps after which all that the server tells is looked at.
const LOOK: u64 = 50;

/// Longer than anything here takes.
const PATIENCE: Duration = Duration::from_secs(60);

/// A secret that is about to expire is waited for, so that it is known what becomes of a call.
const SURELY: i64 = 200_000_000;

/// How often what happened.
pub(super) type Counts = BTreeMap<String, u64>;

pub(super) struct Runner {
    disk: WatchedDisk,
    /// Of the server, beside those of every one.
    options: Vec<&'static str>,
    server: Option<ServerProcess>,
    clients: HashMap<String, Client>,
    model: String,
    words_hash: String,
    pub(super) world: World,
    done: u64,
    pub(super) counts: Counts,
    /// Whether the last step changed nothing.
    pub(super) idle: bool,
    sabotage: Option<Sabotage>,
}

impl Runner {
    /// A server with a token and a model. One of two closes every map that nobody uses, so that it is opened for each step.
    pub(super) async fn new(seed: u64, sabotage: Option<Sabotage>) -> Self {
        let mut options = vec!["--log", "warn", "--wrong-tokens-per-minute", "1000000000"];
        if seed % 2 == 1 {
            options.extend(["--map-memory-mib", "0"]);
        }
        let mut runner = Self {
            disk: WatchedDisk::new(),
            options,
            server: None,
            clients: HashMap::new(),
            model: String::new(),
            words_hash: String::new(),
            world: World::default(),
            done: 0,
            counts: Counts::new(),
            idle: false,
            sabotage,
        };
        runner.start().unwrap();
        let client = runner.running().client().await;
        let named = client.import_model("small", Cursor::new(model().to_bytes())).await.unwrap();
        (runner.model, runner.words_hash) = (named.name, named.words_hash);
        let operator = super::plain::OPERATOR;
        let (_, secret) = client.create_token(operator, v1::token::Role::Admin).await.unwrap();
        runner.world = World::new(secret);
        runner
    }

    fn running(&self) -> &ServerProcess {
        self.server.as_ref().expect("it was started")
    }

    fn start(&mut self) -> Result<(), String> {
        let mut command = self.disk.command();
        // It would grow with every write, and nobody reads it.
        command.env_remove("DISK_RECORD").args(&self.options);
        self.clients.clear();
        self.server = Some(ServerProcess::start_command(command, &self.disk.data())?);
        Ok(())
    }

    fn count(&mut self, what: String) {
        *self.counts.entry(what).or_default() += 1;
    }

    /// Makes a step to the server and to the model: what they do not agree in, if there is anything.
    pub(super) async fn step(&mut self, step: &Step) -> Result<(), String> {
        self.idle = false;
        if let Operation::Restart { end } = step.operation {
            self.count(format!("restart by {end:?}"));
            self.end(end)?;
            self.begin_again().await?;
            return self.look().await;
        }
        if let Operation::Together { map, robots, frames, noise } = step.operation {
            return self.together(step.by, map, robots, (frames, noise)).await;
        }
        let call = Call::of(step, &self.world);
        match step.killed {
            None => drop(self.quietly(&call).await?),
            Some(kill) => self.killed(&call, kill).await?,
        }
        self.done += 1;
        if self.done.is_multiple_of(LOOK) { self.look().await } else { Ok(()) }
    }

    /// Makes a call, and kills nothing; what is answered, which is as it should be.
    pub(super) async fn quietly(&mut self, call: &Call<'_>) -> Result<Answer, String> {
        self.until_surely(call).await;
        let predicted = call.predict(&mut self.world, now_ns(), &mut |_| {});
        let heard = self.make(call, None).await;
        let answer = match heard {
            Heard::Answer(answer) => answer,
            Heard::Secret(token, secret) => self.learn(&token, secret),
            Heard::Said(correction) => said(&mut self.world, &correction),
            Heard::Broken(_, _, error) => return Err(format!("the connection broke: {error}{}", self.log())),
        };
        let refused = matches!(answer, Answer::Refused(_));
        self.count(format!("{}, {}", call.operation.name(), if refused { "refused" } else { "done" }));
        if let Answer::Merge(state) = &answer {
            self.count(format!("merge, {state:?}"));
        }
        agree(&answer, &predicted)?;
        self.idle = refused || call.only_asks();
        if !refused {
            self.check_maps(&call.changes()).await?;
        }
        Ok(answer)
    }

    /// Makes a call to the server, which meets a fault of its disk from then on.
    async fn make(&mut self, call: &Call<'_>, fault: Option<Fault>) -> Heard {
        let clients = std::mem::take(&mut self.clients);
        let mut server = Server { clients, ..self.connected() };
        let disk = &self.disk;
        let heard = server.make(call, || fault.into_iter().for_each(|fault| disk.arm(fault))).await;
        self.clients = server.clients;
        heard
    }

    /// The server, with no connection to it yet.
    pub(super) fn connected(&self) -> Server<'_> {
        Server {
            endpoint: self.running().endpoint(),
            clients: HashMap::new(),
            model: &self.model,
            words_hash: &self.words_hash,
        }
    }

    /// Notes the secret of a token that was made or changed.
    fn learn(&mut self, token: &v1::Token, secret: String) -> Answer {
        let name = token.name.trim_start_matches("tokens/");
        if let Some(known) = self.world.tokens.get_mut(name) {
            known.secret = secret;
            known.expires_ns = token.expire_time_ns;
        }
        Answer::Done
    }

    /// The call is made, and the server is killed meanwhile: at the latest when it is over.
    async fn killed(&mut self, call: &Call<'_>, Kill { nth, halfway }: Kill) -> Result<(), String> {
        self.until_surely(call).await;
        let before = self.world.clone();
        let mut passed = Vec::new();
        let predicted = call.predict(&mut self.world, now_ns(), &mut |world| passed.push(world.clone()));
        let how = if halfway { How::KillHalfway } else { How::Kill };
        let heard = self.make(call, Some(Fault { nth, calls: Calls::CHANGES, how, error: 0 })).await;
        let met = self.disk.counted().1 > 0;
        self.end(End::Kill)?;
        let mut worlds = vec![before];
        worlds.extend(passed);
        worlds.push(self.world.clone());
        let unheard = matches!(heard, Heard::Broken(..));
        let least = match heard {
            Heard::Answer(answer) => {
                agree(&answer, &predicted)?;
                worlds.len() - 1
            }
            Heard::Secret(token, secret) => {
                self.learn(&token, secret);
                *worlds.last_mut().expect("there is one") = self.world.clone();
                worlds.len() - 1
            }
            Heard::Said(correction) => {
                said(&mut self.world, &correction);
                *worlds.last_mut().expect("there is one") = self.world.clone();
                worlds.len() - 1
            }
            Heard::Broken(_, _, error) if !met => {
                return Err(format!("the connection broke, and nothing was killed: {error}{}", self.log()));
            }
            Heard::Broken(outcomes, acknowledged, _) => {
                if let Answer::Frames(all) = &predicted {
                    agree(&outcomes, &all[..outcomes.len()])?;
                }
                acknowledged.min(worlds.len() - 1)
            }
        };
        self.begin_again().await?;
        let client = self.operator().await?;
        // What was begun goes on.
        for job in client.jobs().await.map_err(|error| error.to_string())? {
            followed(&client, &job).await;
        }
        let told = observed(&client).await.map_err(|error| error.to_string())?;
        for world in &mut worlds {
            said_unheard(world, &client).await.map_err(|error| error.to_string())?;
        }
        let same = worlds.iter().rposition(|world| expected(world) == told);
        let came = match same {
            Some(at) if at < least => {
                let (done, there) = (least, at);
                return Err(format!("{done} steps were acknowledged, and after the kill there are {there}"));
            }
            Some(at) if at + 1 == worlds.len() => "after",
            Some(0) => "before",
            Some(_) => "a part",
            None => {
                let differ = worlds[least..].iter().map(|world| differences(&told, &expected(world)));
                // The one that it is most like says what is wrong.
                let nearest = differ.min_by_key(String::len).unwrap_or_default();
                return Err(format!("after a kill, it is nothing that it may be: {nearest}"));
            }
        };
        self.count(format!("kill {}: {came}", if met { "meanwhile" } else { "when it was over" }));
        self.world = worlds.swap_remove(same.unwrap_or_default());
        if unheard {
            self.settle(call, &client).await?;
        }
        Ok(())
    }

    /// Makes sure of what cannot be seen: compactions are asked for again, and tokens whose secret was not heard go.
    async fn settle(&mut self, call: &Call<'_>, client: &Client) -> Result<(), String> {
        match call.operation {
            Operation::CreateToken { token, .. } | Operation::RotateToken { token, .. } => {
                let name = token_name(*token);
                if let Some(token) = self.world.tokens.remove(&name) {
                    client.delete_token(&name).await.map_err(|error| error.to_string())?;
                    self.world.gone.extend(token.former);
                    self.world.gone.retain(|secret| !secret.is_empty());
                }
                Ok(())
            }
            Operation::Compact { .. } => {
                let step = Step {
                    by: super::operations::By::Operator,
                    operation: call.operation.clone(),
                    killed: None,
                };
                let again = Call::of(&step, &self.world);
                self.quietly(&again).await.map(drop)
            }
            _ => Ok(()),
        }
    }

    /// Compares what is told of maps as a whole.
    pub(super) async fn check_maps(&mut self, maps: &[String]) -> Result<(), String> {
        let client = self.operator().await?;
        for name in maps {
            let Some(map) = self.world.maps.get(name) else { continue };
            let told = client.map(name, v1::MapView::Full).await.map_err(|error| error.to_string())?;
            let (told, expected) = (told_map_line(&told), map_line(map));
            if told != expected {
                return Err(format!("maps/{name}: the server tells {told}; it should be {expected}"));
            }
        }
        Ok(())
    }

    /// Compares all that the server tells.
    async fn look(&mut self) -> Result<(), String> {
        let client = self.operator().await?;
        let told = observed(&client).await.map_err(|error| error.to_string())?;
        let differ = differences(&told, &expected(&self.world));
        if differ.is_empty() { Ok(()) } else { Err(differ) }
    }

    pub(super) async fn operator(&mut self) -> Result<Client, String> {
        let secret = self.world.tokens[super::plain::OPERATOR].secret.clone();
        if let Some(client) = self.clients.get(&secret) {
            return Ok(client.clone());
        }
        let options = waypost_client::ClientOptions::new(self.running().endpoint()).with_token(&secret);
        let client = Client::connect(options).await.map_err(|error| error.to_string())?;
        self.clients.insert(secret, client.clone());
        Ok(client)
    }

    /// Ends the server.
    fn end(&mut self, end: End) -> Result<(), String> {
        self.clients.clear();
        let Some(mut server) = self.server.take() else { return Ok(()) };
        let mut ended_well = true;
        if end == End::Stop {
            ended_well = server.terminate(PATIENCE).is_some_and(|status| status.success());
        }
        let log = server.log();
        server.kill();
        self.disk.mend();
        if !ended_well || log.contains("panicked") {
            return Err(format!("the server did not end well:\n{log}"));
        }
        Ok(())
    }

    /// Looks at the database of a server that has ended, and starts another.
    async fn begin_again(&mut self) -> Result<(), String> {
        if let Some(sabotage) = self.sabotage {
            sabotage.commit(&self.disk.data()).await;
        }
        let mut check = Built::command("waypost-server");
        // Its own, since others may listen on those that are usual.
        check.args(["--grpc-address", "127.0.0.1:0", "--http-address", "127.0.0.1:0", "--data-dir"]);
        check.arg(self.disk.data()).args(["check", "--deep"]);
        let checked = run_to_its_end(check);
        if !checked.status.success() {
            let said = [checked.stdout, checked.stderr].concat();
            return Err(format!("check --deep finds {}", String::from_utf8_lossy(&said)));
        }
        self.start()
    }

    /// Looks at everything once more, and ends the server in good order.
    pub(super) async fn finish(&mut self) -> Result<(), String> {
        self.look().await?;
        self.end(End::Stop)?;
        self.begin_again().await?;
        self.look().await
    }

    /// Waits until a secret that expires soon has.
    async fn until_surely(&self, call: &Call<'_>) {
        let token = call.shown.token.as_ref().and_then(|name| self.world.tokens.get(name));
        let Some(expires_ns) = token.and_then(|token| token.expires_ns) else { return };
        let left = expires_ns - now_ns();
        if (-SURELY..3_000_000_000).contains(&left) {
            tokio::time::sleep(Duration::from_nanos((left + SURELY).unsigned_abs())).await;
        }
    }

    fn log(&self) -> String {
        self.server.as_ref().map_or_else(String::new, |server| format!("\n{}", server.log()))
    }
}

/// Notes when something was said.
fn said(world: &mut World, correction: &v1::Correction) -> Answer {
    let said_ns =
        correction.undone.as_ref().map_or(correction.create_time_ns, |undone| undone.create_time_ns);
    if let Some(map) = world.waits() {
        world.said_at(&map, said_ns);
    }
    Answer::Done
}

/// The same where the answer was not heard: it was the last that was said of the map, if it was said.
async fn said_unheard(world: &mut World, client: &Client) -> Result<(), waypost_client::Error> {
    let Some(map) = world.waits() else { return Ok(()) };
    let said = client.corrections(&map).await?;
    let times = said.iter().flat_map(|said| {
        [Some(said.create_time_ns), said.undone.as_ref().map(|undone| undone.create_time_ns)]
    });
    world.said_at(&map, times.flatten().max().unwrap_or_default());
    Ok(())
}

pub(super) fn agree<T, U>(told: &T, expected: &U) -> Result<(), String>
where
    T: PartialEq<U> + std::fmt::Debug + ?Sized,
    U: std::fmt::Debug + ?Sized,
{
    if told == expected {
        return Ok(());
    }
    Err(format!("the server answers {told:?}\n  and should {expected:?}"))
}
