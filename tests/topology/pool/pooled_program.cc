// A worker that does what its YAML says, in one word; started by worker_processes_test.cc.
#include <csignal>
#include <cstdlib>
#include <fstream>
#include <string>

#include <sys/prctl.h>
#include <sys/ptrace.h>
#include <unistd.h>

#include <iotcloud/processes/durable_file.h>
#include <iotcloud/topology/pool/pooled_worker.h>

int main(int, char** argv) {
  using namespace iotcloud;
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
    // Which of these a confined worker still may: a file of the pool, its own log, and to trace a process.
    std::string found;
    if (access((folder + "/../../secret").c_str(), R_OK) == 0 && std::ifstream(folder + "/../../secret"))
      found += "secret ";
    if (std::ofstream(folder + "/mine")) found += "folder ";
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
  if (wanted == "stand still") link.probe_with([](topology::pooled::WorkerReport&) { raise(SIGSTOP); });
  int received = 0;
  sigwait(&ending, &received);
  if (wanted == "stay") pause();
  return 0;
}
