// A worker that does what its YAML says, in one word; started by the tests of worker_fixture.h. With `--for-pool` it
// starts itself for a pool of another user.
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>
#include <utility>

#include <sys/prctl.h>
#include <sys/ptrace.h>
#include <unistd.h>

#include <iotcloud/processes/child_process.h>
#include <iotcloud/processes/durable_file.h>
#include <iotcloud/processes/process_starter.h>
#include <iotcloud/processes/unix_socket.h>
#include <iotcloud/topology/pool/pooled_worker.h>

int main(int argc, char** argv) {
  using namespace iotcloud;
  if (argc == 2) return processes::serve_starter(processes::OwnedDescriptor(STDIN_FILENO), processes::own_program());
  const std::string folder = argv[2];
  sigset_t ending;
  sigemptyset(&ending);
  sigaddset(&ending, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &ending, nullptr);
  topology::PooledWorker link(folder);
  const std::string wanted = processes::read_file(folder + "/" + topology::pooled::yaml_name, 0);
  if (wanted == "refuse" || wanted == "fail") {
    topology::PooledWorker::leave_word(folder, wanted == "refuse", "there is no class");
    return 1;
  }
  if (wanted == "crash") std::abort();
  if (wanted == "look around") {
    // Which of these a worker may: read a file of the pool, and a secret that a topology's file names, make a file in
    // its own folder, connect to a worker's socket as its pool does, and trace a process.
    std::string found;
    if (access((folder + "/../../secret").c_str(), R_OK) == 0 && std::ifstream(folder + "/../../secret"))
      found += "secret ";
    if (std::ifstream(folder + "/../../../of-workers")) found += "of-workers ";
    if (std::ofstream(folder + "/mine")) found += "folder ";
    if (processes::connect_in(folder, topology::pooled::socket_name)) found += "socket ";
    if (ptrace(PTRACE_TRACEME, 0, nullptr, nullptr) == 0) found += "ptrace ";
    if (prctl(PR_GET_NO_NEW_PRIVS, 0, 0, 0, 0) == 1) found += "no-new-privileges ";
    topology::PooledWorker::leave_word(folder, true, found);
    return 1;
  }
  link.show({true, "worker-" + std::to_string(getpid())});
  const std::string long_call = "long call ";
  if (wanted.starts_with(long_call)) {
    link.probe_with([ms = std::stoi(wanted.substr(long_call.size()))](topology::pooled::WorkerReport& answer) {
      answer.component = "count";
      answer.task = 2;
      answer.call_ms = ms;
    });
  }
  if (wanted == "babble") {
    link.probe_with(
        [](topology::pooled::WorkerReport& answer) { answer.worker = std::string(std::size_t{17} << 20, 'x'); });
  }
  if (wanted == "stand still") {
    // Not before one answer has told the pool that it runs.
    link.probe_with([has_told = false](topology::pooled::WorkerReport&) mutable {
      if (std::exchange(has_told, true)) raise(SIGSTOP);
    });
  }
  if (wanted == "log much") {
    for (int line = 0; line < 200'000; ++line) std::puts("a line of its log");
    std::fflush(stdout);
  }
  int received = 0;
  sigwait(&ending, &received);
  if (wanted == "stay") pause();
  return 0;
}
