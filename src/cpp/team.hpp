// Threads that share out work.
#pragma once

#include <algorithm>
#include <atomic>
#include <functional>
#include <system_error>
#include <thread>
#include <vector>

namespace voile {

// As many threads as asked for, of which the caller is one, or as the system has. They wait awake: on a
// virtual machine 0.2 ms pass until one that sleeps goes on.
class Team {
 public:
  explicit Team(int threads) {
    try {
      for (int k = 1; k < threads; ++k) others.emplace_back([this] { wait(); });
    } catch (const std::system_error&) {
    }
  }
  Team(const Team&) = delete;
  Team& operator=(const Team&) = delete;
  ~Team() {
    work = nullptr;
    ++round;
    for (std::thread& other : others) other.join();
  }

  // Calls each(0) to each(count - 1), in this order, each by the first thread that is free.
  void share(int count, const std::function<void(int)>& each) {
    work = &each, end = count, next = 0, busy = (int)others.size();
    ++round;
    serve();
    while (busy) std::this_thread::yield();
  }
  // Calls each(from, to) for 0 to length in pieces, whatever the number of threads.
  template <class Each>
  void split(int length, int piece, const Each& each) {
    if (length > piece)
      share((length + piece - 1) / piece, [&](int k) { each(k * piece, std::min(length, (k + 1) * piece)); });
    else if (length)
      each(0, length);
  }

 private:
  void serve() {
    for (int k; (k = next++) < end;) (*work)(k);
  }
  void wait() {
    for (unsigned seen = 0;; ++seen) {
      while (round == seen) std::this_thread::yield();
      if (!work) return;
      serve();
      --busy;
    }
  }

  std::vector<std::thread> others;
  const std::function<void(int)>* work = nullptr;
  int end = 0;
  std::atomic<int> next = 0, busy = 0;
  std::atomic<unsigned> round = 0;
};

}  // namespace voile
