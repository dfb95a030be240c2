package iotcloud.storm;

import java.util.AbstractList;
import java.util.ArrayList;
import java.util.Collections;
import java.util.HashMap;
import java.util.List;
import java.util.Map;
import java.util.concurrent.ScheduledFuture;
import java.util.concurrent.atomic.AtomicInteger;
import java.util.concurrent.locks.Lock;
import java.util.concurrent.locks.ReentrantLock;
import org.apache.storm.Config;
import org.apache.storm.Constants;
import org.apache.storm.generated.GlobalStreamId;
import org.apache.storm.task.OutputCollector;
import org.apache.storm.task.TopologyContext;
import org.apache.storm.topology.IRichBolt;
import org.apache.storm.tuple.Tuple;
import org.apache.storm.utils.TupleUtils;

/**
 * A bolt of C++. Storm's executor, a thread of ticks and the thread of answers call it, each with its lock, with which it
 * alone emits and answers. The latter two do not wait for a bolt that executes a tuple: they say what is due, and the
 * executor does it after that tuple. A bolt that keeps only the newest tuples of an input runs on a thread of its own
 * instead.
 */
public class CppBolt extends CppComponent implements IRichBolt {
  private static final long serialVersionUID = 1;
  private static final int NONE = -1;
  // What may be due.
  private static final int TICK = 1;
  private static final int ANSWERS = 2;
  private transient ReentrantLock lock;
  private transient AtomicInteger due;
  private transient OutputCollector collector;
  private transient NativeTask task;
  private transient Slots slots;
  private transient Parcel.Finder parcels;
  private transient int executed;
  private transient boolean flushes;
  private transient Map<Integer, List<Source>> sources;
  private transient boolean oneInput;
  private transient ScheduledFuture<?> ticks;
  private transient Thread keeper;
  private transient boolean closed;

  /** The component of the topology's file whose id is this component's. */
  public CppBolt(String file) {
    super(file);
  }

  /** A class of a component library, for Flux and Java. */
  public CppBolt(String library, String className) {
    this(library, className, Collections.emptyMap());
  }

  /** The same; `conf` has texts, numbers and booleans. */
  public CppBolt(String library, String className, Map<String, ?> conf) {
    super("bolt", library, className, conf);
  }

  /** A stream that feeds the bolt. */
  private static final class Source {
    final String stream;
    final int input;

    Source(String stream, int input) {
      this.stream = stream;
      this.input = input;
    }
  }

  @Override
  public void prepare(Map<String, Object> conf, TopologyContext context, OutputCollector out) {
    lock = new ReentrantLock();
    lock.lock();
    try {
      prepareAlone(conf, context, out);
    } finally {
      lock.unlock();
    }
    runDue(TICK | ANSWERS);
  }

  private void prepareAlone(Map<String, Object> conf, TopologyContext context, OutputCollector out) {
    due = new AtomicInteger();
    collector = out;
    slots = new Slots();
    parcels = new Parcel.Finder();
    executed = NONE;
    sources = sources(context);
    oneInput = Description.inputs(context).size() == 1;
    Object batch = conf.get(Config.TOPOLOGY_PRODUCER_BATCH_SIZE);
    flushes = batch instanceof Number && ((Number) batch).intValue() > 1;
    try {
      Native.load(Description.folder(context));
      List<Output> outputs = Description.outputs(context);
      task = new NativeTask(Description.of(origin, context, outputs), outputs, new BoltCollector());
      if (Native.isSpout(task.handle)) {
        throw new IllegalArgumentException(context.getThisComponentId() + " is a spout in C++, not a bolt");
      }
      Egress.add(Native.answering(task.handle), this::applyAnswers);
      task.applyHere(Native.open(task.handle));
    } catch (RuntimeException | UnsatisfiedLinkError error) {
      collector.reportError(error);
      throw error;
    }
    if (Native.keeps(task.handle)) {
      keeper = new Thread(this::runKept, context.getThisComponentId() + "-" + context.getThisTaskId() + "-kept");
      keeper.setDaemon(true);
      keeper.start();
    }
    long micros = Native.ownTickMicros(task.handle);
    if (micros > 0) {
      ticks = Timers.every(micros, this::tickIsDue);
    }
  }

  private static Map<Integer, List<Source>> sources(TopologyContext context) {
    Map<Integer, List<Source>> sources = new HashMap<>();
    List<GlobalStreamId> inputs = Description.inputs(context);
    for (int i = 0; i < inputs.size(); i++) {
      Source source = new Source(inputs.get(i).get_streamId(), i);
      for (int from : context.getComponentTasks(inputs.get(i).get_componentId())) {
        sources.computeIfAbsent(from, id -> new ArrayList<>()).add(source);
      }
    }
    return sources;
  }

  @Override
  public void execute(Tuple tuple) {
    // The stream is at hand; the component has to be looked up.
    boolean isTick = Constants.SYSTEM_TICK_STREAM_ID.equals(tuple.getSourceStreamId()) && TupleUtils.isTick(tuple);
    if (keeper != null) {
      if (isTick) {
        Native.requestTick(task.handle);
      } else {
        keep(tuple);
        runDue(ANSWERS);
      }
      return;
    }
    lock.lock();
    try {
      if (isTick) {
        task.applyHere(Native.tick(task.handle));
      } else {
        executeNow(tuple);
      }
    } finally {
      lock.unlock();
    }
    runDue(TICK | ANSWERS);
  }

  private void executeNow(Tuple tuple) {
    long parcel = parcels.take(tuple);
    int size = parcel != 0 ? 0 : write(tuple);
    if (size == NONE) {
      return;
    }
    byte[][] arrays = task.input.arrays();
    int slot = slots.put(tuple);
    executed = slot;
    task.applyHere(Native.execute(task.handle, slot, inputOf(tuple), tuple.getSourceTask(), size, arrays, parcel));
    executed = NONE;
  }

  /** Writes a tuple's values for C++; fails one that has a value which C++ cannot have, and returns NONE. */
  private int write(Tuple tuple) {
    try {
      return task.input.write(tuple.getValues());
    } catch (ValueWriter.NoValue error) {
      String source = tuple.getSourceComponent() + "/" + tuple.getSourceStreamId();
      collector.reportError(new ComponentError(error.of(source, tuple.getFields().get(error.place()))));
      collector.fail(tuple);
      return NONE;
    }
  }

  private void keep(Tuple tuple) {
    int slot;
    long parcel = parcels.take(tuple);
    int size;
    byte[][] arrays;
    lock.lock();
    try {
      size = parcel != 0 ? 0 : write(tuple);
      if (size == NONE) {
        return;
      }
      arrays = task.input.arrays();
      slot = slots.put(tuple);
    } finally {
      lock.unlock();
    }
    runDue(ANSWERS);
    // Without the lock: it waits while too many tuples wait, and the keeper needs the lock.
    int replaced = Native.keep(task.handle, slot, inputOf(tuple), tuple.getSourceTask(), size, arrays, parcel);
    if (replaced >= 0) {
      lock.lock();
      try {
        collector.ack(slots.take(replaced));
      } finally {
        lock.unlock();
      }
    }
  }

  /** The thread that lets a bolt execute the tuples that it kept. */
  private void runKept() {
    for (int size = Native.runNext(task.handle); size >= 0; size = Native.runNext(task.handle)) {
      lock.lock();
      try {
        task.applyHere(size);
        executed = NONE;
        flush();
      } finally {
        lock.unlock();
      }
      runDue(ANSWERS);
    }
  }

  private int inputOf(Tuple tuple) {
    if (oneInput) {
      return 0;
    }
    List<Source> streams = sources.get(tuple.getSourceTask());
    if (streams.size() > 1) {
      for (Source source : streams) {
        if (source.stream.equals(tuple.getSourceStreamId())) {
          return source.input;
        }
      }
    }
    return streams.get(0).input;
  }

  /** Called by the thread that says when. */
  private void tickIsDue() {
    if (keeper != null) {
      Native.requestTick(task.handle);
      return;
    }
    if ((due.getAndUpdate(before -> before | TICK) & TICK) == 0) {
      giveToOthers();
    }
  }

  /** Called by the thread of answers, which does not run user code: that may take long. */
  private void applyAnswers() {
    due.getAndUpdate(before -> before | ANSWERS);
    runDue(ANSWERS);
    giveToOthers();
  }

  /** Lets another thread do what is due, unless one has the lock: that one does it when it has given the lock back. */
  private void giveToOthers() {
    if (due.get() != 0 && !lock.isLocked()) {
      Timers.run(() -> runDue(TICK | ANSWERS));
    }
  }

  /** Does what is due of these. Whoever has given the lock back calls it, so nothing is left by one that found it taken. */
  private void runDue(int which) {
    while ((due.get() & which) != 0 && lock.tryLock()) {
      try {
        int now = due.getAndUpdate(before -> before & ~which) & which;
        if (closed) {
          return;
        }
        if ((now & ANSWERS) != 0) {
          task.applyHere(Native.takeAnswers(task.handle));
        }
        if ((now & TICK) != 0) {
          task.applyHere(Native.tick(task.handle));
        }
        flush();
      } finally {
        lock.unlock();
      }
    }
  }

  /** Sends what this thread emitted. Storm does so for the executor's thread alone: that of others waits in their batch. */
  private void flush() {
    if (flushes) {
      collector.flush();
    }
  }

  @Override
  public void cleanup() {
    if (ticks != null) {
      ticks.cancel(false);
    }
    if (keeper != null) {
      Native.endKeeping(task.handle);
      try {
        keeper.join();
      } catch (InterruptedException interrupted) {
        Thread.currentThread().interrupt();
        return;
      }
    }
    lock.lock();
    try {
      closed = true;
      task.applyHere(Native.close(task.handle));
    } finally {
      lock.unlock();
    }
  }

  /** Applies the component's commands. */
  private final class BoltCollector implements NativeTask.Collector {
    @Override
    public Lock lock() {
      return lock;
    }

    @Override
    public void executes(int slot) {
      executed = slot;
    }

    @Override
    public List<Integer> emit(String stream, int to, int[] anchors, int count, List<Object> values) {
      try {
        return emitNow(stream, to, anchors, count, values);
      } catch (GroupingError error) {
        collector.reportError(new ComponentError(error.getMessage()));
        for (int i = 0; i < count; i++) {
          failNow(anchors[i]);
        }
        if (executed != NONE) {
          failNow(executed);
        }
        return Collections.emptyList();
      }
    }

    /** Fails a tuple whatever C++, which does not know, answers later. */
    private void failNow(int slot) {
      if (slots.noteFailed(slot)) {
        collector.fail(slots.get(slot));
      }
    }

    private List<Integer> emitNow(String stream, int to, int[] anchors, int count, List<Object> values) {
      if (count == 1) {
        return emit(stream, to, slots.get(anchors[0]), values);
      }
      if (count > 1) {
        return emit(stream, to, new Anchors(anchors, count), values);
      }
      if (to < 0) {
        return collector.emit(stream, values);
      }
      collector.emitDirect(to, stream, values);
      return Collections.singletonList(to);
    }

    private List<Integer> emit(String stream, int to, Tuple anchor, List<Object> values) {
      if (to < 0) {
        return collector.emit(stream, anchor, values);
      }
      collector.emitDirect(to, stream, anchor, values);
      return Collections.singletonList(to);
    }

    private List<Integer> emit(String stream, int to, List<Tuple> anchors, List<Object> values) {
      if (to < 0) {
        return collector.emit(stream, anchors, values);
      }
      collector.emitDirect(to, stream, anchors, values);
      return Collections.singletonList(to);
    }

    @Override
    public List<Integer> emit(String stream, int to, Long id, List<Object> values) {
      throw new IllegalStateException("a bolt emits as a spout");
    }

    @Override
    public Object value(int slot, int place) {
      return slots.get(slot).getValue(place);
    }

    @Override
    public void answer(byte command, int slot) {
      boolean failed = slots.hasFailed(slot);
      if (NativeTask.isReset(command)) {
        if (!failed) {
          collector.resetTimeout(slots.get(slot));
        }
        return;
      }
      if (slot == executed) {
        executed = NONE;
      }
      Tuple tuple = slots.take(slot);
      if (failed) {
        return;
      }
      if (NativeTask.isAck(command)) {
        collector.ack(tuple);
      } else if (NativeTask.isFail(command)) {
        collector.fail(tuple);
      }
    }

    @Override
    public void reportError(Throwable error) {
      collector.reportError(error);
    }
  }

  /** The tuples in some slots, during one emit. */
  private final class Anchors extends AbstractList<Tuple> {
    private final int[] anchors;
    private final int count;

    Anchors(int[] anchors, int count) {
      this.anchors = anchors;
      this.count = count;
    }

    @Override
    public Tuple get(int i) {
      return slots.get(anchors[i]);
    }

    @Override
    public int size() {
      return count;
    }
  }
}
