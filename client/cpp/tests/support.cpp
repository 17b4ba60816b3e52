#include "support.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <random>
#include <stdexcept>

namespace support {
namespace {

namespace fs = std::filesystem;

std::string read(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

std::vector<std::string> environment() {
  std::vector<std::string> kept;
  for (char** entry = environ; *entry != nullptr; ++entry) {
    if (std::string(*entry).rfind("WAYPOST_", 0) != 0) kept.emplace_back(*entry);
  }
  return kept;
}

std::vector<char*> pointers(std::vector<std::string>& texts) {
  std::vector<char*> all;
  for (std::string& text : texts) all.push_back(text.data());
  all.push_back(nullptr);
  return all;
}

// A process whose output goes to a file. It ends with this one.
pid_t spawn(std::vector<std::string> command, std::vector<std::string> variables, const fs::path& output) {
  const std::vector<char*> arguments = pointers(command);
  const std::vector<char*> settings = pointers(variables);
  const std::string file = output.string();
  const pid_t child = fork();
  if (child == -1) throw std::runtime_error("cannot fork");
  if (child != 0) return child;
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  const int out = open(file.c_str(), O_WRONLY | O_CREAT | O_APPEND, 0600);
  dup2(out, STDOUT_FILENO);
  dup2(out, STDERR_FILENO);
  execvpe(arguments[0], arguments.data(), settings.data());
  _exit(127);
}

bool is_free(std::uint16_t port) {
  const int probe = socket(AF_INET, SOCK_STREAM, 0);
  const int on = 1;
  setsockopt(probe, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  const bool bound = bind(probe, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  close(probe);
  return bound;
}

// Below those that the system gives to connections: a client that calls while the server is away may be given its port.
std::string free_address() {
  static std::mt19937 random{std::random_device{}()};
  while (true) {
    const auto port = static_cast<std::uint16_t>(std::uniform_int_distribution<int>(15'000, 32'000)(random));
    if (is_free(port)) return "127.0.0.1:" + std::to_string(port);
  }
}

}  // namespace

TemporaryFolder::TemporaryFolder() {
  std::string pattern = (fs::temp_directory_path() / "waypost-cpp-XXXXXX").string();
  if (mkdtemp(pattern.data()) == nullptr) throw std::runtime_error("cannot make " + pattern);
  path_ = pattern;
}

TemporaryFolder::~TemporaryFolder() {
  std::error_code ignored;
  fs::remove_all(path_, ignored);
}

std::string binary(const std::string& name) {
  const char* folder = std::getenv("WAYPOST_BINARIES");
  const fs::path path = fs::path(folder != nullptr ? folder : WAYPOST_REPOSITORY "/target/release") / name;
  if (!fs::exists(path)) {
    throw std::runtime_error(path.string() + " is missing: run `make build`, or say in WAYPOST_BINARIES where it is");
  }
  return path.string();
}

Ran run(const std::vector<std::string>& command, const std::vector<std::string>& settings) {
  const TemporaryFolder folder;
  std::vector<std::string> variables = environment();
  variables.insert(variables.end(), settings.begin(), settings.end());
  const fs::path output = folder / "output";
  const pid_t child = spawn(command, variables, output);
  int status = 0;
  waitpid(child, &status, 0);
  return {WIFEXITED(status) ? WEXITSTATUS(status) : -1, read(output)};
}

Variable::Variable(std::string name, const std::string& value) : name_(std::move(name)) {
  setenv(name_.c_str(), value.c_str(), 1);
}

Variable::~Variable() { unsetenv(name_.c_str()); }

Server::Server(fs::path data_dir, std::vector<std::string> flags)
    : data_dir_(std::move(data_dir)),
      flags_(std::move(flags)),
      grpc_address_(free_address()),
      http_address_(free_address()) {
  start();
}

void Server::start() {
  const fs::path ready = data_dir_.string() + ".ready";
  const fs::path log = data_dir_.string() + ".log";
  fs::remove(ready);
  std::vector<std::string> command = {binary("waypost-server"), "--data-dir",     data_dir_, "--ready-file",   ready,
                                      "--grpc-address",         grpc_address_, "--http-address", http_address_};
  command.insert(command.end(), flags_.begin(), flags_.end());
  process_ = spawn(command, environment(), log);
  const auto deadline = std::chrono::steady_clock::now() + patience;
  while (!fs::exists(ready)) {
    const bool ended = waitpid(process_, nullptr, WNOHANG) != 0;
    if (ended) process_ = 0;
    if (ended || std::chrono::steady_clock::now() > deadline) {
      kill();
      throw std::runtime_error("the server did not start:\n" + read(log));
    }
    usleep(5'000);
  }
}

void Server::kill() {
  if (process_ == 0) return;
  ::kill(process_, SIGKILL);
  waitpid(process_, nullptr, 0);
  process_ = 0;
}

void Server::freeze() {
  ::kill(process_, SIGSTOP);
  // Its threads stop one after the other: until the last one has, a quick call would still be answered.
  int status = 0;
  if (::waitpid(process_, &status, WUNTRACED) != process_ || !WIFSTOPPED(status)) {
    throw std::runtime_error("the server did not stop");
  }
}
void Server::thaw() { ::kill(process_, SIGCONT); }

const std::vector<fs::path>& images() {
  static const std::vector<fs::path> found = [] {
    std::vector<fs::path> files;
    for (const auto& entry : fs::directory_iterator(WAYPOST_REPOSITORY "/demo/sequence/images")) files.push_back(entry);
    std::sort(files.begin(), files.end());
    return files;
  }();
  return found;
}

waypost::Frame frame(std::uint64_t sequence) {
  const auto stamp_ns = static_cast<std::int64_t>(sequence) * second_ns;
  return {sequence, stamp_ns, waypost::Image::read(images().at(sequence - 1))};
}

}  // namespace support
