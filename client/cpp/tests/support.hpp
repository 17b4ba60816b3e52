// Real servers, and the drive that ships with the repository.
#pragma once

#include <sys/types.h>

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "waypost/waypost.hpp"

namespace support {

using std::chrono_literals::operator""s;
using std::chrono_literals::operator""ms;

// Far more than a start or a stop takes.
inline constexpr std::chrono::seconds patience = 60s;
inline constexpr std::int64_t second_ns = 1'000'000'000;

// A folder that goes with the test.
class TemporaryFolder {
 public:
  TemporaryFolder();
  ~TemporaryFolder();
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;

  std::filesystem::path operator/(const std::string& name) const { return path_ / name; }

 private:
  std::filesystem::path path_;
};

// `waypost-server` or `waypost`, as built from this repository.
std::string binary(const std::string& name);

struct Ran {
  int code;
  std::string output;
};

// Runs a program to its end, with this environment but for settings of Waypost; `NAME=VALUE` are added.
Ran run(const std::vector<std::string>& command, const std::vector<std::string>& settings = {});

// A variable of this process's environment, for as long as this lives.
class Variable {
 public:
  Variable(std::string name, const std::string& value);
  ~Variable();
  Variable(const Variable&) = delete;
  Variable& operator=(const Variable&) = delete;

 private:
  std::string name_;
};

// `waypost-server` in a process of its own, which knows the model `shipped`. It ends with the thread that started it.
class Server {
 public:
  explicit Server(std::filesystem::path data_dir, std::vector<std::string> flags = {});
  ~Server() { kill(); }
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  // Always on the same ports.
  void start();
  // `kill -9`
  void kill();
  // It neither answers nor goes away, until it is thawed.
  void freeze();
  void thaw();

  const std::string& address() const { return grpc_address_; }
  const std::string& http_address() const { return http_address_; }

 private:
  std::filesystem::path data_dir_;
  std::vector<std::string> flags_;
  std::string grpc_address_;
  std::string http_address_;
  pid_t process_ = 0;
};

// The images of the shipped drive, in order.
const std::vector<std::filesystem::path>& images();

// The frame of that number, from 1, of the shipped drive, as `waypost stream` would send it.
waypost::Frame frame(std::uint64_t sequence);

// What a call throws as `Expected`; fails the test if it throws nothing, or something else.
template <class Expected, class Call>
std::string thrown(Call call);

// Waits until something is so; false if it never became so.
template <class Condition>
bool eventually(Condition is_so, std::chrono::milliseconds timeout = patience);

}  // namespace support

#include "support_templates.hpp"
