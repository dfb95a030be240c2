package iotcloud.storm;

import java.util.concurrent.Executors;
import java.util.concurrent.ScheduledExecutorService;
import java.util.concurrent.ScheduledFuture;
import java.util.concurrent.TimeUnit;

/** One thread of this process for all that comes in periods. */
final class Timers {
  private static final ScheduledExecutorService THREAD = Executors.newSingleThreadScheduledExecutor(work -> {
    Thread thread = new Thread(work, "iotcloud-timers");
    thread.setDaemon(true);
    return thread;
  });

  private Timers() {}

  /** What the call throws ends this worker, as what an executor throws does: the schedule alone would drop it silently. */
  static ScheduledFuture<?> every(long micros, Runnable call) {
    return THREAD.scheduleAtFixedRate(() -> {
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
