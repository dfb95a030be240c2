package iotcloud.storm;

import java.util.concurrent.ExecutorService;
import java.util.concurrent.Executors;
import java.util.concurrent.ScheduledExecutorService;
import java.util.concurrent.ScheduledFuture;
import java.util.concurrent.TimeUnit;

/** One thread of this process says when something is due in periods; others do what may take long. */
final class Timers {
  private static final ScheduledExecutorService CLOCK =
      Executors.newSingleThreadScheduledExecutor(work -> daemon(work, "iotcloud-timers"));
  private static final ExecutorService HANDS = Executors.newCachedThreadPool(work -> daemon(work, "iotcloud-ticks"));

  private Timers() {}

  private static Thread daemon(Runnable work, String name) {
    Thread thread = new Thread(work, name);
    thread.setDaemon(true);
    return thread;
  }

  /** Does something on a thread for it alone. */
  static void run(Runnable work) {
    HANDS.execute(work);
  }

  /**
   * Makes a call, which must not wait, again and again; after a standstill no call is made up for. What it throws ends this
   * worker, as what an executor throws does: the schedule alone would drop it silently.
   */
  static ScheduledFuture<?> every(long micros, Runnable call) {
    return CLOCK.scheduleWithFixedDelay(() -> {
      try {
        call.run();
      } catch (RuntimeException | Error error) {
        Thread.UncaughtExceptionHandler handler = Thread.getDefaultUncaughtExceptionHandler();
        if (handler != null) {
          handler.uncaughtException(Thread.currentThread(), error);
        }
        throw error;
      }
    }, micros, micros, TimeUnit.MICROSECONDS);
  }
}
