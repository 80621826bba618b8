// What runs: jobs, one job, workers.
(function () {
  'use strict';
  var el = page.el, replace = page.replace;

  function failure(root, error) { replace(root, el('p.note.bad', null, error)); }

  function comesAfter(job) { return job.waits_for.length ? 'comes after job ' + job.waits_for.join(', ') : ''; }

  function jobRow(job) {
    var share = job.tasks.total ? job.tasks.failed / job.tasks.total : 0;
    return {
      attributes: { 'data-job': job.id },
      cells: [el('a', { href: '#/job/' + job.id }, String(job.id)), page.what(job), page.badge(job.state),
        page.bar(job.progress, 0, share), job.tasks.done + '/' + job.tasks.total + (job.tasks.running ? ' (' + job.tasks.running + ' running)' : ''),
        job.finished ? '' : job.eta_s === null ? '' : page.duration(job.eta_s), page.moment(job.submitted), job.reason || comesAfter(job)]
    };
  }
  var jobColumns = [{ name: 'Job', num: true }, { name: 'What' }, { name: 'State' }, { name: 'Progress' }, { name: 'Tasks' }, { name: 'ETA' }, { name: 'Submitted' }, { name: 'Note' }];

  page.add({
    path: 'jobs', title: 'Jobs',
    draw: function (root) {
      var cards = el('div.cards'), list = el('div#jobs'), wanted = '', before = [0];
      var refresh;
      var choices = [['', 'all'], ['live', 'live'], ['succeeded', 'succeeded'], ['failed', 'failed'], ['cancelled', 'cancelled']];
      var tools = el('div.tools', null, choices.map(function (choice) {
        return el('button', {
          'aria-pressed': choice[0] === '', onclick: function () {
            wanted = choice[0]; before = [0];
            tools.querySelectorAll('button').forEach(function (b) { b.setAttribute('aria-pressed', b === this); }, this);
            refresh();
          }
        }, choice[1]);
      }));
      replace(root, el('h1', null, 'Jobs'), cards, tools, list);
      page.live(function () { return '/api/status'; }, function (s, error) {
        if (error) { return; }
        var scale = s.autoscale;
        replace(cards,
          el('div.card', null, el('b', null, s.workers), el('span', null, 'workers connected')),
          el('div.card', null, el('b', null, s.slots_busy + ' / ' + s.slots), el('span', null, 'slots busy')),
          el('div.card', null, el('b', null, s.tasks_running), el('span', null, 'tasks running')),
          el('div.card', null, el('b', null, s.tasks_ready), el('span', null, 'ready for a worker')),
          el('div.card', null, el('b', null, s.tasks_waiting), el('span', null, 'wait for other tasks')),
          scale ? el('div.card', null, el('b', null, scale.running + ' + ' + scale.pending), el('span', null, 'allocations of ' + scale.manager + ', running + asked for' + (scale.note ? ': ' + scale.note : ''))) : null);
      });
      refresh = page.live(function () {
        return '/api/jobs?state=' + wanted + '&before=' + before[before.length - 1];
      }, function (value, error) {
        if (error) { return failure(list, error); }
        var older = value.more ? el('button', { onclick: function () { before.push(value.jobs[value.jobs.length - 1].id); refresh(); } }, 'older') : null;
        var newer = before.length > 1 ? el('button', { onclick: function () { before.pop(); refresh(); } }, 'newer') : null;
        replace(list, value.jobs.length ? page.table(jobColumns, value.jobs.map(jobRow)) : el('p.soft', null, 'None yet: realitygrad submit iteration --follow'),
          el('div.tools', null, newer, older));
      });
    }
  });

  function stageRow(stage) {
    var total = stage.total || 1, done = stage.done / total;
    return el('div.stage', { 'data-stage': stage.name }, el('b', null, stage.name), page.bar(done, Math.max(0, stage.progress - done), stage.failed / total),
      el('span', null, stage.done + '/' + stage.total + (stage.running ? ', ' + stage.running + ' running' : '') + (stage.failed ? ', ' + stage.failed + ' failed' : '') +
        (stage.seconds !== null ? ' · ' + page.duration(stage.seconds) : '')),
      stage.note ? el('small', null, stage.note) : null);
  }

  function taskRow(task) {
    var outputs = [];
    task.outputs.forEach(function (o) { outputs.push(page.artifact(o.sha256, o.name), ' '); });
    return {
      attributes: { 'data-task': task.name },
      cells: [task.name, task.stage, page.badge(task.state), task.attempts || '', task.worker, task.seconds === null ? '' : page.duration(task.seconds),
        task.progress || task.reason, outputs.length ? el('span', null, outputs) : '']
    };
  }
  var taskColumns = [{ name: 'Task' }, { name: 'Stage' }, { name: 'State' }, { name: 'Attempts', num: true }, { name: 'Worker' }, { name: 'Time' }, { name: 'Note' }, { name: 'Outputs' }];
  var rank = { uncertain: 0, leased: 1, failed: 2, ready: 3, waiting: 4, succeeded: 5, cancelled: 6 };

  // Of many tasks in one state the first few, and the others where somebody asks for them.
  function taskTable(sorted, open, redraw) {
    var kShown = 12, seen = {}, shown = sorted.filter(function (task) {
      seen[task.state] = (seen[task.state] || 0) + 1;
      return open.all || seen[task.state] <= kShown;
    });
    var hidden = Object.keys(seen).filter(function (s) { return seen[s] > kShown; }).map(function (s) { return (seen[s] - kShown) + ' more ' + s; });
    return el('div', null, page.table(taskColumns, shown.map(taskRow)), hidden.length && !open.all ?
      el('div.tools', null, el('button', { onclick: function () { open.all = true; redraw(); } }, hidden.join(', '))) : null);
  }

  function whenAndHowLong(job) {
    if (!job.started) { return [page.duration(job.waited_s), 'waits since']; }
    if (job.finished || job.eta_s === null) { return [page.duration(job.seconds), job.finished ? 'took' : 'took so far']; }
    return [page.duration(job.eta_s), 'to go, about'];
  }

  function followLogs(box, id) {
    var after = 0, lines = [];
    page.live(function () { return '/api/logs?job=' + id + '&after=' + after; }, function (value, error) {
      if (error || !value.lines.length) { return; }
      var atEnd = box.scrollTop + box.clientHeight >= box.scrollHeight - 8;
      after = value.lines[value.lines.length - 1].sequence;
      lines = lines.concat(value.lines.map(function (l) { return l.time.slice(11, 19) + '  ' + l.task + '#' + l.attempt + '  ' + l.text; })).slice(-1000);
      box.textContent = lines.join('\n');
      if (atEnd) { box.scrollTop = box.scrollHeight; }
    });
  }

  page.add({
    path: 'job', title: 'Job', under: 'jobs',
    draw: function (root, id) {
      var open = { all: false };
      var head = el('div'), stages = el('div#stages'), tasks = el('div#tasks'), children = el('div'), events = el('div'), logs = el('pre#logs', { tabindex: 0 }, 'Nothing was said yet.');
      replace(root, head, stages, el('h2', null, 'Tasks'), tasks, children, el('h2', null, 'Logs'), logs, el('h2', null, 'Events'), events);
      page.live(function () { return '/api/job?id=' + id; }, function (job, error) {
        if (error) { return failure(head, error); }
        var time = whenAndHowLong(job);
        replace(head, el('h1', null, 'Job ' + job.id + ' · ' + page.what(job)),
          el('div.tools', null, page.badge(job.state), el('span.soft', null, 'submitted ' + page.moment(job.submitted) + ' by ' + (job.submitted_by || '?') + ', priority ' + job.priority),
            job.parent_job ? el('a', { href: '#/job/' + job.parent_job }, 'of job ' + job.parent_job) : null,
            Object.keys(job.labels).map(function (k) { return el('code', null, k + '=' + job.labels[k]); })),
          job.reason ? el('p.note.bad', null, job.reason) : null,
          comesAfter(job) ? el('p.note', null, 'It ' + comesAfter(job) + '.') : null,
          job.time_limit_s ? el('p.soft', null, 'Time limit ' + page.duration(job.time_limit_s) + (job.deadline ? ', until ' + page.moment(job.deadline) : ' from its start') + '.') : null,
          el('div.cards', null,
            el('div.card', null, el('b', null, Math.round(100 * job.progress) + ' %'), el('span', null, 'done, by weight')),
            el('div.card', null, el('b', null, job.tasks.done + ' / ' + job.tasks.total), el('span', null, 'tasks')),
            el('div.card', null, el('b', null, job.tasks.running), el('span', null, 'running')),
            el('div.card', null, el('b', null, time[0]), el('span', null, time[1])),
            job.best_residual !== null ? el('div.card', null, el('b', null, page.number(job.best_residual)), el('span', null, 'best residual so far')) : null));
        replace(stages, el('h2', null, 'Stages'), job.stages.map(stageRow).reduce(function (d, s) { d.append(s); return d; }, el('div')));
        var sorted = job.task_list.slice().sort(function (a, b) { return rank[a.state] - rank[b.state]; });
        (function redraw() {
          replace(tasks, job.task_list.length ? taskTable(sorted, open, redraw) :
            el('p.soft', null, job.tasks.total + ' tasks: too many to list here; realitygrad job show ' + job.id + ' --tasks does.'));
        })();
      });
      page.live(function () { return '/api/jobs?of=' + id; }, function (value, error) {
        if (error || !value.jobs.length) { return; }
        replace(children, el('h2', null, 'Jobs of its tasks'), page.table(jobColumns, value.jobs.map(jobRow)));
      }, 3000);
      page.live(function () { return '/api/events?job=' + id; }, function (value, error) {
        if (error) { return; }
        replace(events, page.table([{ name: 'Time' }, { name: 'Event' }, { name: 'Task' }, { name: 'Worker' }, { name: 'Detail' }], value.events.map(function (e) {
          return { cells: [page.moment(e.time), e.event, e.task, e.worker, e.detail] };
        })));
      }, 2000);
      followLogs(logs, id);
    }
  });

  page.add({
    path: 'workers', title: 'Workers',
    draw: function (root) {
      var list = el('div#workers');
      replace(root, el('h1', null, 'Workers'), list);
      page.live(function () { return '/api/workers'; }, function (value, error) {
        if (error) { return failure(list, error); }
        replace(list, value.workers.length ? page.table(
          [{ name: 'Name' }, { name: 'Host' }, { name: 'State' }, { name: 'Slots' }, { name: 'Done', num: true }, { name: 'Failed', num: true }, { name: 'Disk free', num: true }, { name: 'Seen' }, { name: 'Tags' }, { name: 'Last error' }],
          value.workers.map(function (w) {
            var state = !w.connected ? 'lost' : w.draining ? 'draining' : w.unable ? 'unable' : w.busy ? 'busy' : 'idle';
            return {
              attributes: { 'data-worker': w.name },
              cells: [w.name, w.host, [page.badge(state), w.unable || w.drain_reason ? el('span.soft', null, ' ' + (w.unable || w.drain_reason)) : null], [page.bar(0, w.slots ? w.busy / w.slots : 0, 0), ' ', el('span.soft', null, w.busy + ' of ' + w.slots)], w.tasks_done, w.tasks_failed, w.disk_free_gib ? w.disk_free_gib + ' GiB' : '',
                w.connected ? 'now' : page.duration(w.last_seen_s) + ' ago', w.tags.join(', '), w.last_error]
            };
          })) : el('p.soft', null, 'None: realitygrad worker starts one.'));
      });
    }
  });
})();
